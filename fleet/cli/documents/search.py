"""The output of `fleet search` and `fleet regress` with `--json`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct
from msgspec.structs import astuple

from fleet.cli.documents.study import Less, SometimesReached, less

if TYPE_CHECKING:
    from fleet.study.failures import FoundFailure, Regressed
    from fleet.study.search import Searched
    from fleet.study.shrink import Shrunk


class Least(Less):
    """The least scenario that fails, as of `fleet shrink`."""


class KeptFailure(Struct):
    """A scenario that a search has kept."""

    file: Annotated[str, Meta(description="In the folder.")]
    check: Annotated[str, Meta(description="That fails, or failed when it was found.")]
    expected: Annotated[str, Meta(description="fail, or pass: every check.")]
    seed: Annotated[int, Meta(description="Of its run.")]
    digest: Annotated[str, Meta(description="SHA-256 of the messages of its log, in hexadecimal.")]
    paste: Annotated[str, Meta(description="A line to paste.")]


class FirstFailing(Struct):
    """`fleet search --json`: the first seed that fails a check, and the least that fails it."""

    scenario: Annotated[str, Meta(description="Name of the scenario.")]
    first_seed: Annotated[int, Meta(description="The first seed that was tried.")]
    runs: Annotated[int, Meta(description="Runs that were judged.")]
    without_result: Annotated[int, Meta(description="Runs without a result.")]
    reason: Annotated[str, Meta(description="Why the first of these has none.")]
    seed: Annotated[int | None, Meta(description="The first seed that fails; null: none did.")]
    check: Annotated[str | None, Meta(description="The check that fails with it.")]
    most_failures: Annotated[
        float | None, Meta(description="If none failed: the share of such runs that may fail at most, 95 % sure.")
    ]
    least: Annotated[Least | None, Meta(description="The least scenario that fails; null: none does, or with --keep.")]
    sometimes: Annotated[list[SometimesReached], Meta(description="What some run must reach, by check.")]
    kept: Annotated[list[KeptFailure], Meta(description="With --keep: what the folder has of this scenario.")]


def first_failing(found: Searched, shrunk: Shrunk | None, file: Path, kept: Sequence[FoundFailure]) -> FirstFailing:
    """The document of a search, and of what was made of the run that it found."""
    least = None if shrunk is None or found.scenario is None else Least(*astuple(less(shrunk, found.scenario, file)))
    return FirstFailing(
        found.name, found.first_seed, found.runs, found.without, found.reason, found.seed, found.check or None,
        found.most_failures, least, [SometimesReached(one.name, one.runs, one.hits, one.seed) for one in found.reached],
        [_kept(one) for one in kept],
    )  # fmt: skip


class RegressedRow(Struct):
    """One scenario of a folder, run again."""

    scenario: Annotated[KeptFailure, Meta(description="What is expected.")]
    as_expected: Annotated[bool, Meta(description="Whether its verdict is the expected one.")]
    got: Annotated[str, Meta(description="What came out, in words.")]
    other_log: Annotated[bool, Meta(description="Whether this version of fleet has made another log before.")]


class RegressedFolder(Struct):
    """`fleet regress --json`: the failures of a folder, run again."""

    directory: Annotated[str, Meta(description="The folder.")]
    as_expected: Annotated[bool, Meta(description="Whether all are.")]
    scenarios: Annotated[list[RegressedRow], Meta(description="Each, by its file.")]


def regressed(folder: Path, found: Sequence[Regressed]) -> RegressedFolder:
    """The document of `fleet regress`."""
    rows = [RegressedRow(_kept(one.failure), one.same, one.got, one.differs) for one in found]
    return RegressedFolder(str(folder), all(one.same for one in found), rows)


def _kept(one: FoundFailure) -> KeptFailure:
    return KeptFailure(one.file, one.check, one.expected, one.seed, one.digest, one.paste)
