"""The probability that a run fails a check, by splitting; repeats are kept in a file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil, copysign, inf, sqrt
from pathlib import Path
from statistics import NormalDist, fmean, pstdev, stdev
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta, Struct

from fleet.addons.studies.branches import Branches, Way, refuse_branches
from fleet.addons.studies.engine import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import NO_MODULES, Modules
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.plan import run_key
from fleet.addons.studies.row import PartRow, Row
from fleet.scenario.scenario import Scenario
from netem.draws import bits
from netem.files import DamagedFile, read_json
from netem.limits import RARE
from netem.whole_file import write_whole

_MARGINS = 3  # changes when other margins count at a moment: such repeats do not mix
_TOGETHER = 8  # parts of runs that a worker makes from one moment
_NOTHING = (
    "nothing that world or network draw while a run goes on changes the margin of {check}, so splitting cannot help: "
    "what fails is decided by the initial state and other things that are drawn before; count with fleet sweep"
)


class RareRepeat(Struct, frozen=True):
    """One independent estimate."""

    seed: Annotated[int, Meta(description="Of what is drawn before the run begins.")]
    probability: Annotated[float, Meta(description="The estimate.", ge=0.0, le=1.0)]
    shares: Annotated[tuple[float, ...], Meta(description="Of the paths of each stage, those that reached its level.")]
    ticks: Annotated[float, Meta(description="Ticks that were simulated.")]
    spread: Annotated[bool, Meta(description="Whether what is drawn on the way made a difference.")]


class RareFile(Struct):
    """The results so far: the file of `fleet rare`, which goes on with the missing ones."""

    key: Annotated[str, Meta(description="Of scenario, check and options.")]
    scenario: str
    check: str
    levels: Annotated[tuple[float, ...], Meta(description="Margins of the stages, in the unit of the check.")] = ()
    pilot_ticks: Annotated[float, Meta(description="Ticks that the pilot simulated.")] = 0.0
    repeats: Annotated[list[RareRepeat], Meta(description="The estimates so far.")] = []


class RareFound(Struct, frozen=True):
    """`fleet rare --json`: the probability that a run fails a check."""

    scenario: str
    check: str
    probability: float
    low: Annotated[float, Meta(description="95 % interval, from the spread of the repeats.")]
    high: Annotated[float | None, Meta(description="The same; null: too few repeats, or none reached a failure.")]
    repeats: int
    levels: Annotated[tuple[float, ...], Meta(description="Margins of the stages, in the unit of the check.")]
    runs: Annotated[float, Meta(description="Cost, in whole runs.")]
    counting: Annotated[
        float | None, Meta(description="Runs that plain Monte Carlo needs for this interval; null: unknown.")
    ]
    decided: Annotated[int, Meta(description="Repeats in which nothing that is drawn on the way made a difference.")]


class RareEvent:
    """Estimates how often a scenario fails a check."""

    def __init__(self, scenario: Scenario, check: str, splitting: Splitting, modules: Modules = NO_MODULES) -> None:
        """Prepare it. Raises StudyError: the scenario or the check cannot be split."""
        refuse_branches(scenario, check)
        self._scenario, self._check, self._splitting, self._modules = scenario, check, splitting, modules
        self._text = scenario.to_undrawn_yaml()

    def run(
        self, engine: Engine, on_progress: Callable[[str, int], None], repeats: int, file: Path, budget_s: float = inf
    ) -> RareFound:
        """Make repeats up to a number. Repeats that the file has are not made again. `on_progress`: called now and then
        with what is done and how many parts of runs were made. `file`: is written after each repeat. `budget_s`: of
        wall time, after which no repeat is begun. Raises StudyError: a run failed, splitting cannot help, or the file
        cannot be used."""
        known, until, seed = self._read(file), time.monotonic() + budget_s, self._scenario.seed
        if not known.levels:
            made = self._make(engine, on_progress, "pilot", seed)
            known.levels, known.pilot_ticks, spread = self._splitting.levels(made, seed)
            if not spread:
                raise StudyError(_NOTHING.format(check=self._check))
            _write(file, known)
        for number in range(len(known.repeats), repeats):
            if time.monotonic() > until:
                break
            own = seed + 1 + number
            made = self._make(engine, on_progress, f"repeat {number + 1} of {repeats}", own)
            known.repeats.append(self._splitting.repeat(made, known.levels, own))
            _write(file, known)
        if not known.repeats:
            raise StudyError("no repeat was made, so nothing is known: raise --budget")
        return self._found(known)

    def _make(self, engine: Engine, on_progress: Callable[[str, int], None], doing: str, seed: int) -> Make:
        count = 0

        def make(asks: Sequence[Ask]) -> list[PartRow]:
            nonlocal count
            found: dict[int, PartRow] = {}  # by place
            tasks = {task.key: (task, places) for task, places in self._tasks(asks, seed)}

            def take(more: list[Row]) -> None:
                for row in more:
                    if not row.futures:
                        raise StudyError(f"a run does not come to its end: {row.reason}")
                    parts = (future.part for future in row.futures)
                    found.update((place, part) for place, part in zip(tasks[row.key][1], parts, strict=True) if part)
                on_progress(doing, count + len(found))

            engine.make((task for task, _ in tasks.values()), take, lambda: on_progress(doing, count + len(found)))
            count += len(found)
            return [found[place] for place in range(len(asks))]

        return make

    def _tasks(self, asks: Sequence[Ask], seed: int) -> Iterator[tuple[Task, list[int]]]:
        """Tasks, each with the places of what it makes: parts that begin at one moment share the way to it."""
        together: dict[tuple[Entrance, float | None], list[int]] = {}
        for place, ask in enumerate(asks):
            together.setdefault((ask.start, ask.level), []).append(place)
        for (start, level), places in together.items():
            for first in range(0, len(places), _TOGETHER):
                some = places[first : first + _TOGETHER]
                salts = tuple(asks[place].salt for place in some)
                key = run_key(f"{self._text}\nseed {seed} salts {salts} place {some[0]}")
                branches = Branches(self._check, start.way or (), salts, start.best, level)
                yield Task(key, 0, seed, self._scenario.name, self._text, inf, self._modules, branches=branches), some

    def _read(self, file: Path) -> RareFile:
        splitting = self._splitting
        options = f"{self._check} {splitting.effort} {splitting.share} {_MARGINS}"
        key = run_key(f"{self._text}\nseed {self._scenario.seed} {options}")
        if not file.exists():
            return RareFile(key, self._scenario.name, self._check)
        try:
            known = read_json(file, RareFile, RARE.bytes)
        except (OSError, DamagedFile) as error:
            raise StudyError(f"{file} cannot be read: {error!s:.200}") from None
        if known.key != key:
            raise StudyError(f"{file} belongs to another scenario, check or option: choose another file with --out")
        return known

    def _found(self, known: RareFile) -> RareFound:
        estimates = [one.probability for one in known.repeats]
        mean, low, high = interval(estimates)
        ticks = known.pilot_ticks + sum(one.ticks for one in known.repeats)
        half = (high - low) / 2
        # Of plain runs, the number whose normal interval is as wide.
        counting = 1.96**2 * mean * (1 - mean) / half**2 if 0 < half < inf else None
        at_most = min(1.0, high) if 0.0 < high < inf else None
        return RareFound(
            known.scenario, known.check, mean, low, at_most, len(estimates), known.levels,
            ticks / self._scenario.ticks, counting, sum(not one.spread for one in known.repeats),
        )  # fmt: skip


def _write(file: Path, known: RareFile) -> None:
    try:
        write_whole(file, msgspec.json.format(msgspec.json.encode(known), indent=1) + b"\n", 0o666)
    except OSError as error:
        raise StudyError(f"{file} cannot be written: {error.strerror}; choose another file with --out") from None


# Multilevel splitting: the probability of an event that is too rare to count.
#
# | symbol | meaning |
# |---|---|
# | S | the score of a path: its least margin so far |
# | L_1 > ... > L_K = 0 | levels; the event is S < 0 |
# | N | effort: paths of a stage |
# | R_k | of the N paths of stage k, those that reach L_k |
#
# A path of stage k begins where a path of the stage before reached L_(k-1), chosen at random, and goes on with draws
# of its own. With fixed levels the product of R_k / N is an unbiased estimate of the probability (M. J. J. Garvels,
# "The splitting method in rare event simulation", 2000; fixed effort). Levels come from a pilot, whose paths are not
# used for the estimate: each is the margin that a given share of the paths gets to (F. Cerou, A. Guyader, "Adaptive
# multilevel splitting for rare event analysis", 2007). Repeats are independent, and their spread gives the interval.

PURPOSE = "split"  # of the draws
MOST_LEVELS = 60
NOWHERE: Way = ()


class Entrance(NamedTuple):
    """Where a path has reached a level."""

    best: float  # its score there
    way: Way | None  # to continue from; None: the path was over by then


START = Entrance(inf, NOWHERE)


class SplitPath(NamedTuple):
    """A path that was made."""

    best: float
    entrances: list[Entrance]  # where its margin was smaller than ever before, in order
    ticks: int


class Ask(NamedTuple):
    """A path that is to be made."""

    start: Entrance
    salt: int
    level: float | None  # where it ends; None: it goes on to its end


Make = Callable[[Sequence[Ask]], Sequence[PartRow]]


@dataclass(frozen=True, slots=True)
class Splitting:
    effort: int = 100
    share: float = 0.25  # of the paths that a level of the pilot lets pass

    def levels(self, make: Make, seed: int) -> tuple[tuple[float, ...], float, bool]:
        """Levels from a pilot, what it cost, and whether the paths of its first stage differed."""
        found: list[float] = []
        entrances, cost, spread = [START], 0.0, True
        for stage in range(MOST_LEVELS):
            paths = self._paths(make, entrances, None, seed, stage)
            cost += sum(path.ticks for path in paths)
            scores = sorted(path.best for path in paths)
            if stage == 0:
                spread = scores[0] != scores[-1]
            level = scores[ceil(self.share * self.effort) - 1]
            if found and level >= found[-1]:  # scores with steps: fewer than that share get to the next one
                level = max((score for score in scores if score < found[-1]), default=inf)
            if not spread or level < 0 or level == inf:
                break
            found.append(level)
            entrances = [_entrance(path, level) for path in paths if is_reached(path.best, level)]
        return (*found, 0.0), cost, spread

    def repeat(self, make: Make, levels: Sequence[float], seed: int) -> RareRepeat:
        entrances, shares, cost, spread = [START], list[float](), 0.0, True
        probability = 1.0
        for stage, level in enumerate(levels):
            paths = self._paths(make, entrances, level, seed, stage)
            cost += sum(path.ticks for path in paths)
            if stage == 0:
                spread = len({path.best for path in paths}) > 1
            entrances = [_entrance(path, level) for path in paths if is_reached(path.best, level)]
            shares.append(len(entrances) / self.effort)
            probability *= shares[-1]
            if not entrances:
                break
        return RareRepeat(seed, probability, tuple(shares), cost, spread)

    def _paths(
        self, make: Make, entrances: Sequence[Entrance], level: float | None, seed: int, stage: int
    ) -> list[SplitPath]:
        asks = []
        for n in range(self.effort):
            start = entrances[bits(seed, PURPOSE, stage, n, 0) % len(entrances)]
            asks.append(Ask(start, 1 + bits(seed, PURPOSE, stage, n, 1) % (2**62), level))
        over = [
            ask.start.way is None or (level is not None and is_reached(ask.start.best, level)) for ask in asks
        ]  # nothing is left to find out
        made = iter(make([ask for ask, known in zip(asks, over, strict=True) if not known]))
        found = []
        for ask, known in zip(asks, over, strict=True):
            start = ask.start
            if known:
                found.append(SplitPath(start.best, [] if start.way is None else [start], 0))
                continue
            part = next(made)
            way = start.way or NOWHERE
            entrances = [Entrance(margin, (*way, (ask.salt, tick))) for margin, tick in part.places]
            found.append(SplitPath(min(part.best, start.best), entrances, part.ticks))
        return found


def is_reached(score: float, level: float) -> bool:
    """Whether a score is at a level; at the last one only below it."""
    return score < 0.0 if level == 0.0 else score <= level


def _entrance(path: SplitPath, level: float) -> Entrance:
    first = next((entrance for entrance in path.entrances if is_reached(entrance.best, level)), None)
    return first or Entrance(path.best, None)


def interval(estimates: Sequence[float], confidence: float = 0.95) -> tuple[float, float, float]:
    """The mean of independent estimates and an interval for it, not below 0; (mean, 0, inf) of fewer than 3.

    It is Student's, corrected for the skewness of the estimates (P. Hall, "On the removal of skewness by
    transformation", J. R. Statist. Soc. B 54(1), 1992). Without skewness it is Student's.
    """
    mean, count = fmean(estimates), len(estimates)
    if (freedom := count - 1) < 2:
        return mean, 0.0, inf
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    # Student's quantile from the normal one (Abramowitz and Stegun, 26.7.5).
    t = z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
    t += (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    spread = pstdev(estimates, mean)
    skewness = fmean(((one - mean) / spread) ** 3 for one in estimates) if spread else 0.0
    g, error = skewness / sqrt(count), stdev(estimates, mean) / sqrt(count)

    def quantile(t: float) -> float:
        """The t whose transform t + g t^2 / 3 + g^2 t^3 / 27 + g / 6 is Student's: Hall's cube inverted."""
        if abs(g) < 1e-6:
            return t
        cube = 1.0 + g * (t - g / 6.0)
        return 3.0 / g * (copysign(abs(cube) ** (1.0 / 3.0), cube) - 1.0)

    return mean, max(0.0, mean - error * quantile(t)), mean - error * quantile(-t)
