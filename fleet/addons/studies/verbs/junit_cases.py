"""What the commands that make many runs write into a JUnit file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fleet.cli.junit import JUnitCase

if TYPE_CHECKING:
    from fleet.addons.studies.failures import FoundFailure, RegressionResult
    from fleet.addons.studies.search import SearchResult
    from fleet.addons.studies.store import Store


def study_cases(store: Store) -> list[JUnitCase]:
    """A case for each point; it has failed if one of the point's runs failed."""
    from fleet.addons.studies.summary import sometimes_reached, summarise

    cases = []
    for row in summarise(store):
        name = ", ".join(f"{key}={value}" for key, value in row.values.items()) or store.record.scenario
        failed = round(row.passed.runs * (1 - row.passed.value)) if row.passed.runs else 0
        failure = f"{failed} of {row.passed.runs} runs failed {store.record.check or 'a check'}" if failed else ""
        error = "" if row.passed.runs else "no run has a result"
        cases.append(JUnitCase(name, failure, error, f"fleet sweep {store.directory}"))
    return [*cases, *(JUnitCase(one.name, "" if one.hits else one.words) for one in sometimes_reached(store))]


def search_cases(found: SearchResult, kept: Sequence[FoundFailure], again: str) -> list[JUnitCase]:
    """A case for each kind of failure, and one for each check that some run must reach. No failure: one passed case."""

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


def regress_cases(found: Sequence[RegressionResult]) -> list[JUnitCase]:
    """A case for each scenario of a folder."""
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
