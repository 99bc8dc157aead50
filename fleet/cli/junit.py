"""The option `--junit` of the commands that judge, and the test cases that each writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli.types import FILE

if TYPE_CHECKING:
    from fleet.result.junit import JUnitCase
    from fleet.result.result import Result
    from fleet.study.failures import FoundFailure, Regressed
    from fleet.study.search import Searched
    from fleet.study.store import Store

JUNIT = click.option("--junit", type=FILE, help="Also write the result as a JUnit file, for CI services.")


def write(path: Path | None, suite: str, cases: Sequence[JUnitCase]) -> None:
    """Write the file, if one was asked for. Raises FleetError: it cannot be written."""
    from fleet.result.junit import write_junit

    if path is not None:
        write_junit(path, suite, cases)


def of_run(result: Result) -> list[JUnitCase]:
    """A case for each check, and one for a run that did not come to its end."""
    from fleet.result.junit import JUnitCase

    meant = result.passed  # a run that is meant to fail
    again = f"fleet run {result.scenario} --seed {result.seed}  # sha256 {result.digest[:16]}"
    cases = [
        JUnitCase(one.check, "" if one.passed or meant else f"{one.asked}; found {one.found}", said=again)
        for one in result.checks
    ]
    if result.reason:
        cases.append(JUnitCase("run", error=result.reason, said=again))
    return cases


def of_study(store: Store) -> list[JUnitCase]:
    """A case for each point; it has failed if one of the point's runs failed."""
    from fleet.result.junit import JUnitCase
    from fleet.study.summary import reached, summarise

    cases = []
    for row in summarise(store):
        name = ", ".join(f"{key}={value}" for key, value in row.values.items()) or store.record.scenario
        failed = round(row.passed.runs * (1 - row.passed.value)) if row.passed.runs else 0
        failure = f"{failed} of {row.passed.runs} runs failed a check" if failed else ""
        error = "" if row.passed.runs else "no run has a result"
        cases.append(JUnitCase(name, failure, error, f"fleet sweep {store.directory}"))
    return [*cases, *(JUnitCase(one.name, "" if one.hits else one.words) for one in reached(store))]


def of_search(found: Searched, kept: Sequence[FoundFailure], again: str) -> list[JUnitCase]:
    """A case for each kind of failure, and one for each check that some run must reach. No failure: one passed case."""
    from fleet.result.junit import JUnitCase

    lines = {failure.check: failure.paste for failure in kept}
    cases = [
        JUnitCase(check, f"seed {seed} fails it", said=lines.get(check, again)) for check, seed in found.kinds.items()
    ]
    if not found.runs:
        cases.append(JUnitCase(found.name, error=found.reason or "no run came to its end"))
    return [
        *(cases or [JUnitCase(f"{found.name}: {found.runs} runs")]),
        *(JUnitCase(one.name, "" if one.hits else one.words) for one in found.reached),
    ]


def of_regress(found: Sequence[Regressed]) -> list[JUnitCase]:
    """A case for each scenario of a folder."""
    from fleet.result.junit import JUnitCase

    return [
        JUnitCase(
            one.failure.file,
            "" if one.same or one.broken else f"expected {one.failure.expected} of {one.failure.check}, {one.got}",
            one.got if one.broken else "",
            one.failure.paste,
            one.wall_s,
        )
        for one in found
    ]
