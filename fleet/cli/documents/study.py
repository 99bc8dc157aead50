"""The output of `fleet sweep` and `fleet shrink` with `--json`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from fleet.scenario.scenario import Scenario, timeline
from fleet.study.measures import MeasureColumn

if TYPE_CHECKING:  # these need the extra `study`, and `fleet schema` does not
    from fleet.study.shrink import Shrunk
    from fleet.study.statistics import Estimate
    from fleet.study.store import Store


class Interval(Struct):
    """A number estimated from several runs, with its confidence interval of 95 % or slightly more."""

    value: Annotated[
        float | None, Meta(description="The number; null: no run has it, or half of them or more never got there.")
    ]
    low: Annotated[float | None, Meta(description="Lower end of the interval; null: too few runs, or infinite.")]
    high: Annotated[float | None, Meta(description="Upper end; null: too few runs, or infinite.")]
    runs: Annotated[int, Meta(description="Number of runs behind it.")]
    level: Annotated[
        float | None, Meta(description="Chance that such an interval holds the true number; null: there is none.")
    ]


class PointRow(Struct):
    """One point of a study: one combination of the varied values, and the results of its runs."""

    values: Annotated[
        dict[str, float | str], Meta(description="By key that is varied; numbers have the unit of the key.")
    ]
    runs: Annotated[int, Meta(description="Runs that were made.")]
    failed: Annotated[int, Meta(description="Of those, without a result.")]
    passed: Annotated[Interval, Meta(description="Share of runs that passed, and its Wilson score interval.")]
    medians: Annotated[dict[str, Interval], Meta(description="By measure: the median, and its exact interval.")]


class SometimesReached(Struct):
    """A check with `sometimes`, over all runs."""

    check: Annotated[str, Meta(description="Its name.")]
    runs: Annotated[int, Meta(description="Runs in which it was judged.")]
    hits: Annotated[int, Meta(description="Of these, that reached it.")]
    seed: Annotated[int | None, Meta(description="The least seed that reached it; null: none did.")]


class Swept(Struct):
    """`fleet sweep --json`: a study, and what it came to."""

    directory: Annotated[str, Meta(description="The study's directory, as it is reached from here.")]
    scenario: Annotated[str, Meta(description="Name of the scenario.")]
    seeds: Annotated[list[int], Meta(description="Seeds of every point; the first ones, if seeds are added.")]
    units: Annotated[
        dict[str, str | None],
        Meta(description="Unit by key that is varied, and by measure; empty: a plain number; null: words."),
    ]
    missing: Annotated[int, Meta(description="Runs that were not made.")]
    points: Annotated[list[PointRow], Meta(description="Every point that has a run, in order.")]
    sometimes: Annotated[list[SometimesReached], Meta(description="What some run must reach, by check.")]


class Size(Struct):
    """How much there is in a scenario."""

    faults: Annotated[int, Meta(description="Number of faults, drawn ones included.")]
    vehicles: Annotated[int, Meta(description="Number of vehicles.")]
    duration_s: Annotated[float, Meta(description="Simulated time [s].")]


class Less(Struct):
    """`fleet shrink --json`: the least scenario that fails, and what was removed."""

    file: Annotated[str, Meta(description="The least scenario.")]
    scenario: Annotated[str, Meta(description="Name of the scenario.")]
    check: Annotated[str, Meta(description="The check that fails.")]
    found: Annotated[list[str], Meta(description="Finding of the check: at first, and in the least scenario.")]
    runs: Annotated[int, Meta(description="Runs that were made.")]
    steps: Annotated[list[str], Meta(description="The reductions, in words and in order.")]
    before: Annotated[Size, Meta(description="The first scenario.")]
    after: Annotated[Size, Meta(description="The least one.")]


def swept(store: Store, measures: Sequence[MeasureColumn]) -> Swept:
    """The document of a study. Raises StudyError."""
    from fleet.study.summary import summarise

    record, rows = store.record, summarise(store, measures)
    units = {axis.key: axis.unit for axis in record.axes} | {measure.name: measure.unit for measure in measures}
    points = [
        PointRow(
            row.values, row.runs, row.failed, _interval(row.passed),
            {name: _interval(found) for name, found in row.medians.items()},
        )
        for row in rows
    ]  # fmt: skip
    return Swept(str(store.directory), record.scenario, record.seeds, units, store.missing, points, sometimes(store))


def sometimes(store: Store) -> list[SometimesReached]:
    """The requirements that some run of a study must meet. Raises StudyError."""
    from fleet.study.summary import reached

    return [SometimesReached(one.name, one.runs, one.hits, one.seed) for one in reached(store)]


def less(found: Shrunk, before: Scenario, file: Path) -> Less:
    """The document of a scenario that was made less."""
    return Less(
        str(file), before.name, found.check, list(found.found), found.runs, found.steps,
        _size(before), _size(found.scenario),
    )  # fmt: skip


def _interval(found: Estimate) -> Interval:
    return Interval(found.value, found.low, found.high, found.runs, found.level)


def _size(scenario: Scenario) -> Size:
    return Size(len(timeline(scenario)), scenario.vehicles, scenario.duration_ns / 1e9)
