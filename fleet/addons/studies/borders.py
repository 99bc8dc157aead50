"""Where it breaks: runs of a scenario that are placed so that they tell where its pass rate falls through a level.

A study of a border is a study like any other, but not every point is run with every seed. Its last axis is the one
along which the border is looked for; every combination of the other axes has a border of its own. The n-th run of each
border has the n-th seed, wherever it is. All borders get runs in rounds, of a batch each. The next runs depend only on
the rows of earlier rounds. So the number of workers or an interruption changes nothing.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from math import ceil, inf, isfinite, log
from pathlib import Path
from typing import Literal, Protocol, cast

from msgspec import structs

from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import NO_MODULES, Modules
from fleet.addons.studies.one_run import A_STUDY, Task
from fleet.addons.studies.plan import Plan, changes_of, parse_seeds
from fleet.addons.studies.psychometric import CONFIDENCE, RISING, PsychometricCurve, Walk, steepest_rise
from fleet.addons.studies.record import BorderRecord
from fleet.addons.studies.row import Row
from fleet.addons.studies.spec import BoundarySpec
from fleet.addons.studies.statistics import Estimate, pass_rate
from fleet.addons.studies.store import Store
from fleet.addons.studies.sweep import Progress, Work, prepare, task_of
from fleet.addons.studies.values import Axis, axis, parse_axis
from fleet.analysis.link_shares import effective_loss
from fleet.analysis.stability import analyse, dead_reckoning, oldest_s, shunting_decay
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy

MOST_STEPS = 500  # of a range, where they are chosen for the user
MOST_PLACES = 1000  # along an axis; each takes 0.3 MB
Rows = dict[tuple[int, int], Row]  # by point and seed
Run = tuple[int, bool]  # number of the value along the axis, and whether it passed


class OnProgress(Protocol):
    def __call__(self, progress: Progress, *, known: int, of: int) -> None:
        """`known` borders of `of` are found."""


@dataclass(frozen=True, slots=True)
class Border:
    """Where the pass rate falls through the level, at one combination of the other axes."""

    values: dict[str, float | str]  # of the other axes, by key
    value: float  # in the unit of the axis; -inf: below the range; inf: above it; NaN: perhaps outside
    low: float  # the interval of 95 %; -inf and inf: it goes beyond the range
    high: float
    runs: int  # with a verdict
    failed: int  # without a result
    first: Estimate  # the pass rates at both ends of the range
    last: Estimate
    rising: tuple[float, float] | None  # neighbouring values with a significant rise of the pass rate between them

    @property
    def where(self) -> Literal["within", "below", "above", "open"]:
        """Where it lies: within the range, below or above it, or with a side of its interval open."""
        if self.low == inf or self.high == -inf:
            return "above" if self.low == inf else "below"
        return "within" if isfinite(self.low) and isfinite(self.high) else "open"


def parse_along(text: str, width: float) -> Axis:
    """The axis along which a border is looked for: at least two numbers, rising. `text`: `KEY=VALUES`, where a range
    needs no step. `width`: of the interval that is wanted, as a share of the range; such a range has steps that are
    narrower. Raises StudyError: it is none."""
    if not 0.0 < width < 1.0:
        raise StudyError(f"the width of an interval is a share of the range between 0 and 1, got {width:g}")
    found = parse_axis(text, fine=min(ceil(1.5 / width), MOST_STEPS))
    if found.sampled:
        raise StudyError(f"{found.key}: a border needs given values, and these are drawn")
    numbers = [value.number for value in found.values]
    if None in numbers or len(numbers) < 2 or numbers != sorted(numbers, key=lambda number: number or 0.0):
        raise StudyError(f"--along {text:.60}: expected a range such as 0 %..95 %, or two or more rising numbers")
    if len(numbers) > MOST_PLACES:
        raise StudyError(f"{found.key}: {len(numbers)} values are too many: at most {MOST_PLACES} are possible")
    return replace(found, option="--along")


def border_plan(scenario: str, spec: BoundarySpec) -> Plan:
    """The runs that a study of a border may need. Raises StudyError: the values are none, or do not fit together."""
    per = (replace(axis(key, text), option="--per") for key, text in spec.per.items())
    axes = (*per, parse_along(spec.along, spec.width))
    return Plan(scenario, changes_of(spec), axes, seeds=parse_seeds(spec.seeds))


def prepare_borders(
    plan: Plan, spec: BoundarySpec, directory: Path | Iterable[Path], warn: Callable[[str], None] = lambda _: None
) -> tuple[Store, Modules]:
    """Check every point that may be run, and make the directory of the study. `plan`: the plan. The border is sought
    along its last axis, see `parse_along`. `spec`: the settings of the study. The directory keeps them. `directory`:
    as for `prepare`. `warn`: called
    with a line of text for each check that cannot pass. Raises ScenarioError: with the mistakes of all points;
    StudyError: there cannot be such a study."""
    if not 0.0 < spec.level < 1.0:
        raise StudyError(f"the level must be between 0 and 1, got {spec.level:g}")
    border = BorderRecord(**structs.asdict(spec), log=plan.axes[-1].scale == "log")
    return prepare(plan, directory, border=border, warn=warn)


class Borders:
    """The borders of a study, and the runs of each."""

    def __init__(self, store: Store) -> None:
        """Read the points of a study. Raises StudyError: it looks for no border, or is damaged."""
        record = store.record.border
        if record is None:
            raise StudyError(
                f"{store.directory} is not a study of borders. To continue it: fleet sweep {store.directory}"
            )
        self.store, self.record, self.points = store, record, store.points
        axes = store.record.axes
        if not axes or not self.points:
            raise StudyError(f"{store.directory} is damaged: it has no axis, or no points")
        self.along = axes[-1]
        self.keys = [axis.key for axis in axes[:-1]]
        if self.along.unit is None:
            raise StudyError(f"{store.directory} is damaged: the values of its border are words")
        first = [self.points[0].values[key] for key in self.keys]
        self.places = [
            self._place(n) for n, p in enumerate(self.points) if [p.values[key] for key in self.keys] == first
        ]
        self.count = len(self.points) // len(self.places)
        self._check()
        scaled = [log(place, 10.0) if record.log else place for place in self.places]
        self._first, self._span = scaled[0], scaled[-1] - scaled[0]
        self.curve = PsychometricCurve([(place - self._first) / self._span for place in scaled], record.level)
        self.walk = Walk(self.curve, record.width)

    @property
    def title(self) -> str:
        rate = f"pass rate of {self.record.check}" if self.record.check else "pass rate"
        return f"{self.store.record.scenario}: where the {rate} falls through {100 * self.record.level:g} %"

    def _check(self) -> None:
        """Raises StudyError: the points are not those of a study of borders. A study may come from anybody."""
        if (
            not 2 <= len(self.places) <= MOST_PLACES
            or any(high <= low for low, high in pairwise(self.places))
            or (self.record.log and self.places[0] <= 0.0)
            or not 0.0 < self.record.level < 1.0
            or [self._place(number) for number in range(len(self.points))] != self.places * self.count
        ):
            raise StudyError(f"{self.store.directory} is damaged: its points are not those of a study of borders")

    def _place(self, number: int) -> float:
        return cast(float, self.points[number].values[self.along.key])

    def rows(self) -> list[Rows]:
        """Of each border the rows by point and seed. Raises StudyError."""
        found: list[Rows] = [{} for _ in range(self.count)]
        for row in self.store.rows():
            found[row.point // len(self.places)][row.point, row.seed] = row
        return found

    def open(self) -> bool:
        """Whether runs are missing. Raises StudyError."""
        rows = self.rows()
        return any(_Walk(self, number).missing(of) for number, of in enumerate(rows))

    def estimates(self) -> list[Border]:
        """The present estimate of each border. Raises StudyError."""
        return [self._border(number, list(rows.values())) for number, rows in enumerate(self.rows())]

    def verdicts(self, rows: Iterable[Row]) -> list[Run]:
        return [(row.point % len(self.places), row.passed) for row in rows if row.passed is not None]

    def value(self, position: float) -> float:
        scaled = self._first + position * self._span
        return float(10.0**scaled) if self.record.log else scaled

    def _border(self, number: int, rows: list[Row]) -> Border:
        runs = self.verdicts(rows)
        found = self.curve.belief(self.curve.posterior(runs))
        first, last = (
            pass_rate(sum(passed for at, passed in runs if at == end), sum(at == end for at, _ in runs))
            for end in (0, len(self.places) - 1)
        )
        rise = steepest_rise(runs)
        point = self.points[number * len(self.places)]
        low = -inf if found.low < 0.0 else self.value(found.low)
        high = inf if found.high > 1.0 else self.value(found.high)
        value = self.value(found.border) if 0.0 <= found.border <= 1.0 else float("nan")
        if found.above > CONFIDENCE:
            low = value = inf
        elif found.below > CONFIDENCE:
            high = value = -inf
        return Border(
            {key: point.values[key] for key in self.keys}, value, low, high, len(runs), len(rows) - len(runs),
            first, last, (self.places[rise.near], self.places[rise.far]) if rise.chance <= RISING else None,
        )  # fmt: skip


def find_borders(
    borders: Borders, engine: Engine, on_progress: OnProgress, *, modules: Modules = NO_MODULES, timeout_s: float = inf
) -> None:
    """Make the missing runs until every border is known well enough, or has used its seeds. Raises StudyError: rows
    cannot be written, and earlier ones stay; KeyboardInterrupt: at any time, and rows that were made are written."""
    store = borders.store
    walks = [_Walk(borders, number) for number in range(borders.count)]
    work = Work(
        store, engine, lambda now: on_progress(now, known=sum(walk.ended for walk in walks), of=len(walks)), inf
    )
    with store.lock():
        carried = engine.carry(modules)
        like = Task("", 0, 0, store.record.scenario, "", timeout_s, carried, keep=str(store.logs))
        rows = borders.rows()
        work.progress.runs, work.progress.made = borders.count * len(store.record.seeds), sum(map(len, rows))
        while True:
            missing = [run for walk, of in zip(walks, rows, strict=True) for run in walk.missing(of)]
            work.wait()
            if not missing:
                return
            work.make(task_of(borders.points[point], seed, like) for point, seed in missing)
            rows = borders.rows()


class _Walk:
    """The runs of one border in their order."""

    def __init__(self, borders: Borders, number: int) -> None:
        self._borders, self._offset = borders, number * len(borders.places)
        self._seeds: Iterator[int] = iter(borders.store.record.seeds)
        self._batch: list[tuple[int, int]] = []
        self._runs: list[Run] = []
        self.ended = False

    def missing(self, rows: Rows) -> list[tuple[int, int]]:
        """Go through the runs up to the first batch with missing runs; (point, seed) of each of those."""
        while not self.ended:
            missing = [run for run in self._batch if run not in rows]
            if missing:
                return missing
            self._runs += self._borders.verdicts(rows[run] for run in self._batch)
            wanted = self._borders.walk.next_runs(self._runs)
            self._batch = [
                (self._offset + at, seed) for at, seed in zip(wanted, islice(self._seeds, len(wanted)), strict=False)
            ]
            self.ended = not self._batch
        return []


@dataclass(frozen=True, slots=True)
class Theory:
    """Theory at the low end of a border's range, and along it, to be drawn beside the result of the simulations; None:
    it is not known, or the rule does not apply.

    `fleet check` leaves loss out. Here it enters the rule of dead reckoning as age: of a link that loses the share p,
    what is heard last is p / (1 - p) rounds older on average.
    """

    shunting: tuple[float, float] | None  # K lambda_max(L+B) and a [1/s]; the first must be smaller
    stable: bool | None  # whether the linear loop is, for the final value of K, at the low end
    reckoning: int | None  # of the first value with K tau rho(A) >= 1 for the mean age under loss; their number: none


def theory(borders: Borders) -> list[Theory]:
    """Of each border what theory says. Raises ScenarioError: a law of a scenario may not be loaded here, or a scenario
    is damaged."""
    return [_theory(borders, number, Policy(A_STUDY)) for number in range(borders.count)]


def _theory(borders: Borders, number: int, policy: Policy) -> Theory:
    places, store = len(borders.places), borders.store

    def scenario(place: int) -> Scenario:
        text = borders.points[number * places + place].scenario
        return parse_scenario(text, store.record.scenario, folder=store.folder, policy=policy)

    first = scenario(0)
    found = analyse(first)
    decay, loop = shunting_decay(first), found.at_settled
    stable = None if loop is None or found.settled is None else not loop.unstable(max(found.settled))
    reckoning = None
    if _reckoning(first) is not None:
        reckoning = bisect_left(range(places), 1.0, key=lambda place: _reckoning(scenario(place)) or 0.0)
    shunting = None if decay is None or found.gain_max is None else (found.gain_max * found.lambda_max, decay)
    return Theory(shunting, stable, reckoning)


def _reckoning(scenario: Scenario) -> float | None:
    lost = max((condition.loss for condition in scenario.conditions.values()), default=0.0)
    lost = max([lost, *map(effective_loss, scenario.changing.values())])
    if lost >= 1.0:
        return float("inf")
    round_s = scenario.round_ticks * scenario.tick_ns / 1e9
    return dead_reckoning(scenario, analyse(scenario, linear=False), oldest_s(scenario) + round_s * lost / (1.0 - lost))
