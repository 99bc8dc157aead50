"""What `--json` prints of many runs: the documents of sweep, boundary, shrink, search and regress."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta, Struct

from fleet.addons.studies.failures import FoundFailure
from fleet.addons.studies.measures import MeasureColumn
from fleet.addons.studies.row import Covered
from fleet.scenario.scenario import Scenario, timeline

if TYPE_CHECKING:  # these need the extra `study`, and `fleet about --schemas` does not
    from fleet.addons.studies.borders import Border, Borders
    from fleet.addons.studies.failures import RegressionResult
    from fleet.addons.studies.row import Reached
    from fleet.addons.studies.search import SearchResult
    from fleet.addons.studies.shrink import Shrunk
    from fleet.addons.studies.small_space import WholeSpace
    from fleet.addons.studies.statistics import Estimate
    from fleet.addons.studies.store import Store


class Interval(Struct):
    """A number estimated from several runs, with its confidence interval of 95 % or slightly more."""

    value: Annotated[float | None, Meta(description="null: no run has it, or half of them or more never got there.")]
    low: float | None
    high: float | None
    runs: int
    level: Annotated[float | None, Meta(description="Chance that such an interval holds the true number; null: none.")]


class PointRow(Struct):
    """One point of a study: one combination of the varied values, and the results of its runs."""

    values: Annotated[dict[str, float | str], Meta(description="By varied key, in its unit.")]
    runs: int
    failed: Annotated[int, Meta(description="Without a result.")]
    passed: Annotated[Interval, Meta(description="Share, with its Wilson score interval.")]
    medians: Annotated[
        dict[str, Interval],
        Meta(description="By measure, with exact intervals; of `check.NAME` the share of runs that passed it."),
    ]


class SometimesReached(Struct):
    """A check with `sometimes`, over all runs."""

    check: str
    runs: int
    hits: int
    seed: Annotated[int | None, Meta(description="The least seed that reached it; null: none did.")]


class Swept(Struct):
    """`fleet sweep --json`: a study, and what it came to."""

    directory: str
    scenario: str
    seeds: Annotated[list[int], Meta(description="Seeds of every point; the first ones, if seeds are added.")]
    check: Annotated[str, Meta(description="That says whether a run passed; empty: all of them do.")]
    units: Annotated[dict[str, str | None], Meta(description="By key and measure; empty: a plain number; null: words.")]
    missing: int
    points: list[PointRow]
    sometimes: list[SometimesReached]


class BorderFound(Struct):
    """Where the pass rate falls through the level, at one combination of the other keys."""

    values: Annotated[dict[str, float | str], Meta(description="Of the other keys.")]
    where: Annotated[str, Meta(description="`within` the range, `below` it, `above` it, or `open`: not known.")]
    value: Annotated[float | None, Meta(description="null: it is outside.")]
    low: Annotated[float | None, Meta(description="Of its interval of 95 %; null: beyond the range.")]
    high: Annotated[float | None, Meta(description="null: beyond the range.")]
    runs: int
    failed: int
    first: Annotated[Interval, Meta(description="Pass rate at the low end.")]
    last: Interval
    rising: Annotated[tuple[float, float] | None, Meta(description="Between these values the pass rate rises.")]


class BoundaryFound(Struct):
    """`fleet boundary --json`: the borders of a scenario."""

    directory: Annotated[str, Meta(description="Of the study.")]
    scenario: str
    along: Annotated[str, Meta(description="The key along which the border is looked for.")]
    unit: str
    units: Annotated[dict[str, str | None], Meta(description="Of the other keys; null: their values are words.")]
    check: Annotated[str, Meta(description="Whose pass rate it is; empty: that of all checks.")]
    level: float
    picture: Annotated[str | None, Meta(description="null: there is too much for one.")]
    borders: list[BorderFound]
    sometimes: list[SometimesReached]


class Size(Struct):
    """How much there is in a scenario."""

    faults: int
    vehicles: int
    duration_s: float


class ShrunkScenario(Struct):
    """`fleet shrink --json`: the least scenario that fails, and what was removed."""

    file: str
    scenario: str
    check: str
    found: Annotated[tuple[str, str], Meta(description="Finding of the check: at first, and in the least scenario.")]
    runs: int
    steps: list[str]
    before: Size
    after: Size


class FirstFailing(Struct):
    """`fleet search --json`: the first seed that fails a check, and the least that fails it."""

    scenario: str
    first_seed: int
    runs: int
    without_result: int
    reason: Annotated[str, Meta(description="Why the first of these has none.")]
    seed: Annotated[int | None, Meta(description="The first seed that fails; null: none did.")]
    check: str | None
    most_failures: Annotated[
        float | None, Meta(description="If none failed: the share of such runs that may fail at most, 95 % sure.")
    ]
    least: Annotated[
        ShrunkScenario | None, Meta(description="The least scenario that fails; null: none does, or with --keep.")
    ]
    sometimes: list[SometimesReached]
    kept: Annotated[list[FoundFailure], Meta(description="With --keep: what the folder has of this scenario.")]
    triggered: Annotated[
        dict[str, str], Meta(description="By the id of a fault of the failing run: the report that began it.")
    ]
    covered: Annotated[
        Covered | None,
        Meta(
            description="Of episodes: their number, how many of each kind, the faults of each kind, the unit [s] and "
            "what states it, and the probabilities that given patterns of two and of three vehicles that are cut off "
            "were drawn; null: no partition is drawn."
        ),
    ]
    space: Annotated[int | None, Meta(description="With --all: how many runs the space has; null: without it.")] = None


class RegressedRow(Struct):
    """One scenario of a folder, run again."""

    scenario: FoundFailure
    as_expected: Annotated[bool, Meta(description="Whether its verdict is the expected one.")]
    got: str
    other_log: Annotated[bool, Meta(description="Whether this version of fleet has made another log before.")]


class RegressedFolder(Struct):
    """`fleet regress --json`: the failures of a folder, run again."""

    directory: str
    as_expected: bool
    scenarios: list[RegressedRow]


def sweep_document(store: Store, measures: Sequence[MeasureColumn]) -> Swept:
    """The document of a study. Raises StudyError."""
    from fleet.addons.studies.summary import sometimes_reached, summarise

    record = store.record
    units = {axis.key: axis.unit for axis in record.axes} | {measure.name: measure.unit for measure in measures}
    points = [
        PointRow(row.values, row.runs, row.failed, _interval(row.passed),
                 {name: _interval(found) for name, found in row.medians.items()})
        for row in summarise(store, measures)
    ]  # fmt: skip
    return Swept(str(store.directory), record.scenario, record.seeds, record.check, units, store.missing, points,
                 _sometimes(sometimes_reached(store)))  # fmt: skip


def boundary_document(borders: Borders, found: Sequence[Border], picture: str | None) -> BoundaryFound:
    """The document of a study of a border."""
    from fleet.addons.studies.summary import sometimes_reached

    store, along = borders.store, borders.along
    rows = [
        BorderFound(row.values, row.where, row.value, row.low, row.high, row.runs, row.failed,
                    _interval(row.first), _interval(row.last), row.rising)
        for row in found
    ]  # fmt: skip
    units, record = {axis.key: axis.unit for axis in store.record.axes[:-1]}, borders.record
    return BoundaryFound(str(store.directory), store.record.scenario, along.key, along.unit or "", units,
                         record.check, record.level, picture, rows, _sometimes(sometimes_reached(store)))  # fmt: skip


def shrink_document(found: Shrunk, before: Scenario, file: Path) -> ShrunkScenario:
    """The document of a scenario that was made less."""
    sizes = [Size(len(timeline(one)), one.vehicles, one.duration_ns / 1e9) for one in (before, found.scenario)]
    return ShrunkScenario(str(file), before.name, found.check, found.found, found.runs, found.steps, *sizes)


def first_failing(found: SearchResult, shrunk: Shrunk | None, file: Path, kept: Sequence[FoundFailure]) -> FirstFailing:
    """The document of a search, and of what was made of the run that it found."""
    least = None if shrunk is None or found.scenario is None else shrink_document(shrunk, found.scenario, file)
    return FirstFailing(
        found.name, found.first_seed, found.runs, found.without, found.reason, found.seed, found.check or None,
        found.most_failures, least, _sometimes(found.reached), [*kept],
        found.triggered, found.covered,
    )  # fmt: skip


def whole_space(scenario: Scenario, found: WholeSpace, shrunk: Shrunk | None, file: Path) -> FirstFailing:
    """The document of a search through a whole space."""
    least = None if shrunk is None or found.scenario is None else shrink_document(shrunk, found.scenario, file)
    seed = None if found.scenario is None else scenario.seed
    return FirstFailing(
        scenario.name, scenario.seed, found.runs, found.without, found.reason, seed, found.check or None, None, least,
        [], [], {}, None, found.size,
    )  # fmt: skip


def regress_document(folder: Path, found: Sequence[RegressionResult]) -> RegressedFolder:
    """The document of `fleet regress`."""
    rows = [RegressedRow(one.failure, one.same, one.got, one.differs) for one in found]
    return RegressedFolder(str(folder), all(row.as_expected for row in rows), rows)


def _interval(found: Estimate) -> Interval:
    return Interval(*found)


def _sometimes(found: Sequence[Reached]) -> list[SometimesReached]:
    return [SometimesReached(one.name, one.runs, one.hits, one.seed) for one in found]
