"""The point of no return: the last moment of a failed run when healing all faults would still make it pass.

This module first makes the run once more in this process. It takes a snapshot about every second (or every hundredth
of the run), and notes whether the check has failed by then. Then it tries healed runs. In a healed run all faults end
at one moment, and no fault begins later. Up to that moment it is the same run, to the last bit.

Some checks have a margin that is the least over the time. Such a check had not failed before the snapshot, so its
healed run starts there. Any other check remembers what was before, so its healed run starts at 0.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, inf
from typing import Annotated, Any, Literal, NamedTuple

from msgspec import Meta, Struct

from fleet.analysis.verdicts import standing
from fleet.errors import ScenarioError
from fleet.execution.in_process import in_process
from fleet.execution.outcome import judge_run, settle
from fleet.quantities import show_time, time_ns
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import NoLog
from fleet.recorder.metrics import VehicleError
from fleet.recorder.snapshot import Snapshot
from fleet.result.result import Result, Status
from fleet.result.verdict import Verdict
from fleet.scenario.loading import changed
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import EVERY
from fleet.scenario.sections.log_rates import snapshot_grid
from fleet.scenario.sections.timeline import Event
from fleet.study.branches import Branch, checks_over_time
from fleet.study.engine import Engine
from fleet.study.errors import StudyError
from fleet.study.modules import NO_MODULES, Modules
from fleet.study.one_run import Task, scenario_of
from fleet.study.plan import run_key
from fleet.study.row import Row
from fleet.study.shrink import Tree, tree_of
from netem.lives import Lives
from netem.wire.messages import Command, Fate, Frame
from world.config import vehicle_memories

RUNS = "runs that are healed"  # what is being made, for `tell`
_FIRST, _THEN = 6, 3  # moments that are tried together
_EVERY_NS = 1_000_000_000
_LEAST_MOMENTS, _MOST_MOMENTS = 10, 100

How = Literal["bisected", "scanned", "not needed", "not possible"]


class HealedRun(Struct, frozen=True):
    """A run that was healed at a moment."""

    at_s: Annotated[float, Meta(description="No fault was on from this time on.")]
    passed: Annotated[bool | None, Meta(description="null: it could not be judged.")]
    from_snapshot: Annotated[bool, Meta(description="Whether only the rest of the run was made, from a snapshot.")]


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
    state: bytes  # snapshot; empty: there is none
    failed: bool  # whether the check had failed by then


@dataclass(slots=True)
class Remade:
    """The run, made once more."""

    scenario: Scenario  # with as many snapshots as there are moments
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
    """A sink of the journal: keeps every snapshot, and the checks that have failed by then."""

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
            self.moments.setdefault(check, []).append(HealMoment(frame.tick, b"", known))

    def packet(self, fate: Fate) -> None: ...
    def event(self, event: Event) -> None: ...

    def snapshot(self, snapshot: Snapshot) -> None:
        state = snapshot.to_bytes()
        for moments in self.moments.values():
            if moments[-1].tick == snapshot.tick:
                moments[-1] = moments[-1]._replace(state=state)


def with_moments(scenario: Scenario) -> Scenario:
    """The scenario with a snapshot at each moment when healing is possible."""
    every_ns = _every(scenario) * scenario.tick_ns
    return changed(scenario, [f"log.snapshot={show_time(every_ns)}"])


def _every(scenario: Scenario) -> int:
    grid = snapshot_grid(scenario.spec)
    a_second = min(_EVERY_NS // scenario.tick_ns, scenario.ticks // _LEAST_MOMENTS)
    wanted = max(a_second, ceil(scenario.ticks / _MOST_MOMENTS))
    return max(1, ceil(wanted / grid)) * grid


def remake(scenario: Scenario, progress: Callable[[float], None]) -> Remade:
    """Make the run once more, in this process. `scenario`: as `with_moments` gives it. `progress`: called with the
    share that is done. Raises CheckError if a check in Python cannot be made.
    """
    watch = _Watch(scenario, _every(scenario))
    runner, log = in_process(scenario, watch), NoLog()
    watch.journal = journal = runner.journal
    result = Result(scenario=scenario.name, seed=scenario.seed, status=Status.PASS)
    if broken := runner.to_end(lambda: progress(max(0, journal.written) / scenario.ticks)):
        return Remade(scenario, broken=broken.reason)
    settle(journal, log, runner, result)
    judge_run(scenario, journal, result, lost=0)
    return Remade(scenario, result.checks, watch.moments)


class HealingSearch:
    """Looks for the point of no return of one check."""

    def __init__(
        self,
        remade: Remade,
        check: str,
        engine: Engine,
        tell: Callable[[str, int], None],
        modules: Modules = NO_MODULES,
    ) -> None:
        """Prepare it; `tell` is called now and then with what is being done and how many runs were made."""
        self._scenario, self._check, self._engine, self._tell = remade.scenario, check, engine, tell
        self._modules, self._tree = modules, tree_of(remade.scenario)
        self._over_time = check in checks_over_time(remade.scenario)
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

    def _candidates(self, remade: Remade) -> list[HealMoment]:
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
        return [*(without[-1:] or [HealMoment(0, b"", False)]), *others]

    def _try(self, places: Sequence[int]) -> None:
        new = [self._moments[k] for k in dict.fromkeys(places) if self._moments[k].tick not in self._known]
        tasks = {moment.tick: self._task(moment) for moment in new}
        rows: dict[str, Row] = {}

        def take(more: list[Row]) -> None:
            rows.update((row.key, row) for row in more)
            self._tell(RUNS, len(self._known) + len(rows))

        made = [task for task in tasks.values() if task is not None]
        self._engine.make(iter(made), take, lambda: self._tell(RUNS, len(self._known) + len(rows)))
        for tick, task in tasks.items():
            at_s = tick * self._scenario.tick_ns / 1e9
            passed = None if task is None else self._passed(rows[task.key], task)
            self._known[tick] = HealedRun(at_s, passed, task is not None and task.branch is not None)

    def _task(self, moment: HealMoment) -> Task | None:
        """Make the run that is healed at a moment. None: the healed text is not a valid scenario."""
        tree = healed(self._tree, moment.tick * self._scenario.tick_ns)
        text, seed = json.dumps(tree), self._scenario.seed
        key = run_key(f"{text}\nhealed at {moment.tick} {self._check}")
        task = Task(key, 0, seed, self._scenario.name, text, inf, self._modules)
        try:
            absences = scenario_of(task).faults.absences
        except ScenarioError:
            return None
        if not self._over_time or not moment.state or _lacks_an_agent(moment, Lives(absences)):
            return task
        return task._replace(branch=Branch(self._check, 0, moment.state))

    def _passed(self, row: Row, task: Task) -> bool | None:
        if not row.judged:
            raise StudyError(f"a healed run does not come to its end: {row.reason}")
        if row.part is not None:
            return row.part.best >= 0.0
        check = row.checks.get(self._check)
        if check is None:  # it was about a fault that never began
            return True
        if check.passed is None:  # there was nothing to judge, or no time for it
            return None if json.loads(task.text).get("faults") else True
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
            words = f"healing does not help: no healed run passes, not even the one without any fault ({runs})"
            return NoReturn(how, words, None, tried[0].at_s, tried)
        passes = self._known[self._moments[low].tick]
        if high is None:
            words = f"healed at {passes.at_s:g} s, the last snapshot before it failed, it still passes ({runs})"
            return NoReturn(how, words, passes.at_s, None, tried)
        fails = self._known[self._moments[high].tick]
        then = "it fails" if fails.passed is False else "there is no time left to judge it"
        words = f"healed at {passes.at_s:g} s it passes, healed at {fails.at_s:g} s {then} ({runs})"
        return NoReturn(how, words, passes.at_s, fails.at_s, tried)


def healed(tree: Tree, at_ns: int) -> Tree:
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


def _lacks_an_agent(moment: HealMoment, lives: Lives) -> bool:
    """Whether a snapshot has no memory of an agent that is there in the healed run, which so cannot begin with it."""
    snapshot = Snapshot.from_bytes(moment.state)
    vehicles = [known.vehicle for known in vehicle_memories(snapshot.world)]
    return any(i not in snapshot.memories and not lives.without_agent(i, moment.tick) for i in vehicles)
