"""What `fleet search` prints with `--json`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct
from msgspec.structs import astuple

from fleet.cli.documents.study import Less, less

if TYPE_CHECKING:
    from fleet.study.search import Searched
    from fleet.study.shrink import Shrunk


class Least(Less):
    """The least scenario that fails, as of `fleet shrink`."""


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
    least: Annotated[Least | None, Meta(description="The least scenario that fails; null: none does.")]


def first_failing(found: Searched, shrunk: Shrunk | None, file: Path) -> FirstFailing:
    """The document of a search, and of what was made of the run that it found."""
    least = None if shrunk is None or found.scenario is None else Least(*astuple(less(shrunk, found.scenario, file)))
    return FirstFailing(
        found.name, found.first_seed, found.runs, found.without, found.reason, found.seed, found.check or None,
        found.most_failures, least,
    )  # fmt: skip
