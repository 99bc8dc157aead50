"""The point of no return: the last moment of a failed run when healing all faults would still make it pass.

This module first makes the run once more in this process. About every second (or every hundredth of the run) it notes
whether the check has failed by then. Then it tries healed runs. In a healed run all faults end at one moment, and no
fault begins later. Up to that moment it is the same run, to the last bit, so a worker makes it once
for several moments.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, inf
from typing import Annotated, Any, Literal, NamedTuple

from msgspec import Meta, Struct

from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import NO_MODULES, Modules
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.plan import run_key
from fleet.addons.studies.row import Row
from fleet.addons.studies.shrink import Tree, tree_of
from fleet.analysis.verdicts import standing
from fleet.execution.in_process import start_in_process
from fleet.execution.outcome import judge_run, settle
from fleet.quantities import show_time, time_ns
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import NoLog
from fleet.recorder.metrics import VehicleError
from fleet.result.result import Result, Status
from fleet.result.verdict import Verdict
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import EVERY
from fleet.scenario.sections.log_rates import moment_grid
from fleet.scenario.sections.timeline import Event
from netem.wire.messages import Command, Fate, Frame

RUNS = "runs that are healed"  # what is being made, for `on_progress`
_FIRST, _THEN = 6, 3  # moments that are tried together
_EVERY_NS = 1_000_000_000
_LEAST_MOMENTS, _MOST_MOMENTS = 10, 100

How = Literal["bisected", "scanned", "not needed", "not possible"]


class HealedRun(Struct, frozen=True):
    """A run that was healed at a moment."""

    at_s: Annotated[float, Meta(description="No fault was on from this time on.")]
    passed: Annotated[bool | None, Meta(description="null: it could not be judged.")]
    from_snapshot: Annotated[bool, Meta(description="Always false: there are no snapshots since 1.1.")] = False


class NoReturn(Struct, frozen=True):
    """The point of no return, or why there is none."""

    how: How
    words: str
    passes_s: Annotated[float | None, Meta(description="The last moment from which it passes; null: none.")] = None
    fails_s: Annotated[float | None, Meta(description="The next tried moment, from which it fails.")] = None
    tried: list[HealedRun] = []


class HealMoment(NamedTuple):
    """A moment of the run when healing is possible."""

    tick: int
    failed: bool  # whether the check had failed by then


@dataclass(slots=True)
class Rerun:
    """The run, made once more."""

    scenario: Scenario
    verdicts: list[Verdict] = field(default_factory=list)
    moments: dict[str, list[HealMoment]] = field(default_factory=dict)  # by check
    broken: str = ""  # why it ended early

    def failed_between(self, check: str) -> tuple[float, float]:
        """The last time when the check held, and the first when it had failed [s]; both are the end if only the end
        shows that.
        """
        tick_s, end = self.scenario.tick_ns / 1e9, self.scenario.duration_ns / 1e9
        moments = self.moments.get(check, [])
        k = len(moments)
        while k and moments[k - 1].failed:
            k -= 1
        before = moments[k - 1].tick * tick_s if k else 0.0
        return (before, moments[k].tick * tick_s) if k < len(moments) else (end, end)


class _Watch:
    """A sink of the journal: notes at each moment the checks that have failed by then."""

    def __init__(self, scenario: Scenario, every: int) -> None:
        self.journal: Journal | None = None
        self.moments: dict[str, list[HealMoment]] = {}
        self._scenario, self._every = scenario, every

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        if frame.tick % self._every or frame.tick >= self._scenario.ticks:
            return
        assert self.journal is not None
        failed: dict[str, bool] = {}
        for row in standing(self._scenario, self.journal):
            failed[row["check"]] = failed.get(row["check"], False) or row["passed"] is False
        for check, known in failed.items():
            self.moments.setdefault(check, []).append(HealMoment(frame.tick, known))

    def packet(self, fate: Fate) -> None: ...
    def event(self, event: Event) -> None: ...


def _every(scenario: Scenario) -> int:
    grid = moment_grid(scenario.spec)
    a_second = min(_EVERY_NS // scenario.tick_ns, scenario.ticks // _LEAST_MOMENTS)
    wanted = max(a_second, ceil(scenario.ticks / _MOST_MOMENTS))
    return max(1, ceil(wanted / grid)) * grid


def remake(scenario: Scenario, progress: Callable[[float], None]) -> Rerun:
    """Make the run once more, in this process. `progress`: called with the share that is done. Raises CheckError if a
    check in Python cannot be made.
    """
    watch = _Watch(scenario, _every(scenario))
    runner, log = start_in_process(scenario, watch), NoLog()
    watch.journal = journal = runner.journal
    result = Result(scenario=scenario.name, seed=scenario.seed, status=Status.PASS)
    if broken := runner.to_end(lambda: progress(max(0, journal.written) / scenario.ticks)):
        return Rerun(scenario, broken=broken.reason)
    settle(journal, log, runner, result)
    judge_run(scenario, journal, result, lost=0)
    return Rerun(scenario, result.checks, watch.moments)


class HealingSearch:
    """Looks for the point of no return of one check."""

    def __init__(
        self,
        remade: Rerun,
        check: str,
        engine: Engine,
        on_progress: Callable[[str, int], None],
        modules: Modules = NO_MODULES,
    ) -> None:
        """Prepare it; `on_progress` is called now and then with what is being done and how many runs were made."""
        self._scenario, self._check, self._engine, self._on_progress = remade.scenario, check, engine, on_progress
        self._modules, self._tree = modules, tree_of(remade.scenario)
        self._text = json.dumps(self._tree)
        self._moments = self._candidates(remade)
        self._known: dict[int, HealedRun] = {}  # by tick

    def run(self, most_runs: int) -> NoReturn:
        """Find it. Raises StudyError if a run that is healed does not come to its end."""
        if not self._scenario.spec.faults:
            return NoReturn("not needed", "the run had no fault, so there was nothing to heal")
        moments = self._moments
        self._try(_spread(0, len(moments) - 1, min(_FIRST, max(2, most_runs))))
        low, high = self._bounds()
        while self._ordered() and high is not None and low is not None and high - low > 1:
            left = most_runs - len(self._known)
            if left <= 0:
                break
            self._try(_spread(low, high, min(_THEN, left) + 2)[1:-1])
            low, high = self._bounds()
        if self._ordered():
            return self._found("bisected", low, high)
        self._try(_spread(0, len(moments) - 1, max(2, most_runs - len(self._known))))
        return self._found("scanned", *self._bounds())

    def _candidates(self, remade: Rerun) -> list[HealMoment]:
        """The moments before the failure when healing makes a difference. No fault has begun at the first one."""
        moments = list(remade.moments.get(self._check, []))
        while moments and moments[-1].failed:
            moments.pop()
        tick_ns = self._scenario.tick_ns
        faults = self._tree.get("faults") or []
        begins = min((time_ns(fault["at"]) for fault in faults), default=0)
        last = max((_end(fault) for fault in faults), default=inf)
        without = [one for one in moments if one.tick * tick_ns <= begins]
        others = [one for one in moments if begins < one.tick * tick_ns < last]
        return [*(without[-1:] or [HealMoment(0, False)]), *others]

    def _try(self, places: Sequence[int]) -> None:
        new = sorted({self._moments[k].tick for k in places} - self._known.keys())
        lines = -(-len(new) // _THEN)  # each is made by one worker, which goes along the run
        tasks = [self._task(tuple(new[first::lines])) for first in range(lines)]
        count = len(self._known)
        rows: dict[str, Row] = {}

        def take(more: list[Row]) -> None:
            rows.update((row.key, row) for row in more)
            self._on_progress(RUNS, count + sum(len(row.futures) for row in rows.values()))

        self._engine.make(iter(tasks), take, lambda: self._on_progress(RUNS, count))
        for task in tasks:
            row = rows[task.key]
            if not row.futures:
                raise StudyError(f"a healed run does not come to its end: {row.reason}")
            for (tick, text), future in zip(task.healed, row.futures, strict=True):
                at_s = tick * self._scenario.tick_ns / 1e9
                self._known[tick] = HealedRun(at_s, self._passed(future, text))

    def _task(self, ticks: tuple[int, ...]) -> Task:
        """Make the runs that are healed at some ticks."""
        tick_ns, seed = self._scenario.tick_ns, self._scenario.seed
        each = tuple((tick, json.dumps(without_faults_after(self._tree, tick * tick_ns))) for tick in ticks)
        key = run_key(f"{self._text}\nhealed at {ticks} {self._check}")
        return Task(key, 0, seed, self._scenario.name, self._text, inf, self._modules, healed=each)

    def _passed(self, row: Row, text: str) -> bool | None:
        if not row.judged:
            raise StudyError(f"a healed run does not come to its end: {row.reason}")
        check = row.checks.get(self._check)
        if check is None:  # it was about a fault that never began
            return True
        if check.passed is None:  # there was nothing to judge, or no time for it
            return None if json.loads(text).get("faults") else True
        return check.passed

    def _bounds(self) -> tuple[int | None, int | None]:
        """Indices of the last moment that passes, and of the next moment that was tried and fails."""
        tried = [k for k, moment in enumerate(self._moments) if moment.tick in self._known]
        passing = [k for k in tried if self._known[self._moments[k].tick].passed]
        low = passing[-1] if passing else None
        return low, next((k for k in tried if low is None or k > low), None)

    def _ordered(self) -> bool:
        found = [bool(self._known[tick].passed) for tick in sorted(self._known)]
        return found == sorted(found, reverse=True)

    def _found(self, how: How, low: int | None, high: int | None) -> NoReturn:
        tried = [self._known[tick] for tick in sorted(self._known)]
        runs = f"{len(tried)} healed {'run' if len(tried) == 1 else 'runs'}"
        if how == "scanned":
            runs += ", and some that were healed earlier do not pass"
        if low is None:
            words = f"it fails even without faults ({runs})"
            return NoReturn(how, words, None, tried[0].at_s, tried)
        passes = self._known[self._moments[low].tick]
        if high is None:
            words = f"healed at {passes.at_s:g} s, the last moment before it failed, it still passes ({runs})"
            return NoReturn(how, words, passes.at_s, None, tried)
        fails = self._known[self._moments[high].tick]
        then = "it fails" if fails.passed is False else "there is no time left to judge it"
        words = f"healed at {passes.at_s:g} s it passes, healed at {fails.at_s:g} s {then} ({runs})"
        return NoReturn(how, words, passes.at_s, fails.at_s, tried)


def without_faults_after(tree: Tree, at_ns: int) -> Tree:
    """A scenario that heals all faults at a time: active faults end, and later ones never begin."""
    faults: list[dict[str, Any]] = []
    gone: set[str] = set()
    for number, fault in enumerate(tree.get("faults") or [], start=1):
        begin = time_ns(fault["at"])
        if begin >= at_ns:
            gone.add(str(fault.get("id", f"f{number}")))
        else:
            ends = {"for": show_time(at_ns - begin)} if _end(fault) > at_ns else {}
            faults.append({"id": f"f{number}", **fault, **ends})
    checks = dict(tree.get("checks") or {})
    for key in ("recovery_time", "signal"):
        some = checks.get(key)
        each = [some] if isinstance(some, dict) else some or []
        left = [check for check in each if check.get("fault", EVERY) not in gone]
        if len(left) < len(each):
            checks = {name: value for name, value in checks.items() if name != key} | ({key: left} if left else {})
    return {**tree, "faults": faults, "checks": checks}


def _end(fault: Mapping[str, Any]) -> float:
    return time_ns(fault["at"]) + time_ns(fault["for"]) if "for" in fault else inf


def _spread(first: int, last: int, count: int) -> list[int]:
    count = max(1, min(count, last - first + 1))
    if count == 1:
        return [first]
    return list(dict.fromkeys(first + round(k * (last - first) / (count - 1)) for k in range(count)))
