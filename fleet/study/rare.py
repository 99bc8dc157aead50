"""The probability that a run fails a check, by splitting; repeats are kept in a file."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from fleet.scenario.scenario import Scenario
from fleet.study.branches import Branch, refuse_branches
from fleet.study.engine import Engine, Row
from fleet.study.errors import StudyError
from fleet.study.modules import NO_MODULES, Modules
from fleet.study.one_run import Task
from fleet.study.plan import run_key
from fleet.study.splitting import Ask, Make, SplitPath, Splitting, interval
from netem.private_file import read_file, write_whole

_MOST_BYTES = 10_000_000
_MARGINS = 2  # changes when other margins count at a snapshot: such repeats do not mix
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
    scenario: Annotated[str, Meta(description="Name of the scenario.")]
    check: Annotated[str, Meta(description="The check.")]
    levels: Annotated[tuple[float, ...], Meta(description="Margins of the stages, in the unit of the check.")] = ()
    pilot_ticks: Annotated[float, Meta(description="Ticks that the pilot simulated.")] = 0.0
    repeats: Annotated[list[RareRepeat], Meta(description="The estimates so far.")] = []


class RareFound(Struct, frozen=True):
    """`fleet rare --json`: the probability that a run fails a check."""

    scenario: Annotated[str, Meta(description="Name of the scenario.")]
    check: Annotated[str, Meta(description="The check.")]
    probability: Annotated[float, Meta(description="Mean of the repeats.")]
    low: Annotated[float, Meta(description="95 % interval, from the spread of the repeats.")]
    high: Annotated[float | None, Meta(description="The same; null: too few repeats, or none reached a failure.")]
    repeats: Annotated[int, Meta(description="Independent estimates.")]
    levels: Annotated[tuple[float, ...], Meta(description="Margins of the stages, in the unit of the check.")]
    runs: Annotated[float, Meta(description="What all cost, in whole runs.")]
    counting: Annotated[float | None, Meta(description="Runs that counting needs for that interval; null: unknown.")]
    decided: Annotated[int, Meta(description="Repeats in which nothing that is drawn on the way made a difference.")]


class RareEvent:
    """Estimates how often a scenario fails a check."""

    def __init__(self, scenario: Scenario, check: str, splitting: Splitting, modules: Modules = NO_MODULES) -> None:
        """Prepare it.

        Raises:
            StudyError: the scenario or the check cannot be split.
        """
        refuse_branches(scenario, check)
        self._scenario, self._check, self._splitting, self._modules = scenario, check, splitting, modules
        self._text = scenario.to_undrawn_yaml()

    def run(
        self, engine: Engine, tell: Callable[[str, int], None], repeats: int, file: Path, budget_s: float = inf
    ) -> RareFound:
        """Make repeats up to a number. Repeats that the file has are not made again.

        Args:
            tell: called now and then with what is done and how many parts of runs were made.
            file: is written after each repeat.
            budget_s: of wall time, after which no repeat is begun.

        Raises:
            StudyError: a run failed, splitting cannot help, or the file cannot be used.
        """
        known, until, seed = self._read(file), time.monotonic() + budget_s, self._scenario.seed
        if not known.levels:
            made = self._make(engine, tell, "pilot", seed)
            known.levels, known.pilot_ticks, spread = self._splitting.levels(made, seed)
            if not spread:
                raise StudyError(_NOTHING.format(check=self._check))
            _write(file, known)
        for number in range(len(known.repeats), repeats):
            if time.monotonic() > until:
                break
            own = seed + 1 + number
            made = self._make(engine, tell, f"repeat {number + 1} of {repeats}", own)
            found = self._splitting.repeat(made, known.levels, own)
            known.repeats.append(RareRepeat(own, found.probability, found.shares, found.cost, found.spread))
            _write(file, known)
        if not known.repeats:
            raise StudyError("no repeat was made, so nothing is known: raise --budget")
        return self._found(known)

    def _make(self, engine: Engine, tell: Callable[[str, int], None], doing: str, seed: int) -> Make:
        """A function that makes parts of runs of a seed."""
        count = 0

        def make(asks: Sequence[Ask]) -> list[SplitPath]:
            nonlocal count
            rows: dict[str, Row] = {}
            tasks = [self._task(ask, seed, place) for place, ask in enumerate(asks)]

            def take(more: list[Row]) -> None:
                rows.update((row["key"], row) for row in more)
                tell(doing, count + len(rows))

            engine.make(iter(tasks), take, lambda: tell(doing, count + len(rows)))
            count += len(rows)
            if failed := next((row for row in rows.values() if row["status"] != "pass"), None):
                raise StudyError(f"a run does not come to its end: {failed['reason']}")
            ordered = (rows[task.key] for task in tasks)
            return [SplitPath(row["best"], [(m, s) for m, s in row["places"]], row["ticks"]) for row in ordered]

        return make

    def _task(self, ask: Ask, seed: int, place: int) -> Task:
        branch = Branch(self._check, ask.salt, ask.start.state or b"", ask.start.best, ask.level)
        key = run_key(f"{self._text}\nseed {seed} salt {ask.salt} place {place}")
        return Task(key, 0, seed, self._scenario.name, self._text, inf, self._modules, branch=branch)

    def _read(self, file: Path) -> RareFile:
        splitting = self._splitting
        options = f"{self._check} {splitting.effort} {splitting.share} {_MARGINS}"
        key = run_key(f"{self._text}\nseed {self._scenario.seed} {options}")
        if not file.exists():
            return RareFile(key, self._scenario.name, self._check)
        try:
            known = msgspec.json.decode(read_file(file, _MOST_BYTES), type=RareFile)
        except (OSError, ValueError, msgspec.MsgspecError) as error:
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
        write_whole(file, msgspec.json.format(msgspec.json.encode(known), indent=1) + b"\n")
    except OSError as error:
        raise StudyError(f"{file} cannot be written: {error.strerror}; choose another file with --out") from None
