"""The probability that a run fails a check, by splitting; repeats are kept in a file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from math import inf
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from fleet.addons.studies.branches import Branches, refuse_branches
from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import NO_MODULES, Modules
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.plan import run_key
from fleet.addons.studies.row import PartRow, Row
from fleet.addons.studies.splitting import Ask, Entrance, Make, RareRepeat, Splitting, interval
from fleet.scenario.scenario import Scenario
from netem.files import DamagedFile, read_json
from netem.limits import RARE
from netem.whole_file import write_whole

_MARGINS = 3  # changes when other margins count at a moment: such repeats do not mix
_TOGETHER = 8  # parts of runs that a worker makes from one moment
_NOTHING = (
    "nothing that world or network draw while a run goes on changes the margin of {check}, so splitting cannot help: "
    "what fails is decided by the initial state and other things that are drawn before; count with fleet sweep"
)


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
