"""Would a guided search gain if its runs began at snapshots of the runs that they are made of?

    python benchmarks/guided_branches.py election --runs 24
    python benchmarks/guided_branches.py lossy --runs 24

A run of `fleet search --guide` has the faults of another run, changed. Up to the first change the two are one run, so
it could begin at a snapshot of the other. This script makes each run whole, as the search does, and those that could
begin later from such a snapshot as well, with one snapshot per second. It prints the CPU time of both.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from fleet.checks.own_checks import OwnChecks
from fleet.execution.clock import GrantPolicy
from fleet.execution.in_process import InProcess
from fleet.recorder.journal import Journal
from fleet.recorder.metrics import VehicleError
from fleet.recorder.snapshot import Snapshot, Start
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.timeline import Event
from fleet.study.engine import Row
from fleet.study.guided import GuidedSearch
from fleet.study.guided_memory import KnownRun
from fleet.study.modules import Modules
from fleet.study.moves import Draws
from fleet.study.one_run import Task, make_run
from fleet.study.shrink import Tree
from netem.wire.messages import Command, Fate, Frame

EVERY = "log.snapshot=1 s"


class Family(GuidedSearch):
    """A guided search that knows of what each run was made."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self.parents: dict[str, tuple[KnownRun, float | None]] = {}  # by key of the run: what it is made of, and when

    def _moved(self, draws: Draws) -> tuple[Task | None, Tree]:
        corpus, chosen = self._corpus, list[tuple[KnownRun, float | None]]()
        choose = type(corpus).choose

        def watched(draws: Draws) -> tuple[KnownRun, float | None]:
            chosen.append(choose(corpus, draws))
            return chosen[-1]

        self._corpus = _Watched(corpus, watched)  # type: ignore[assignment]
        task, tree = super()._moved(draws)
        self._corpus = corpus
        if task is not None:
            self.parents[task.key] = chosen[-1]
        return task, tree


class _Watched:
    """A corpus whose choice is watched."""

    def __init__(self, corpus: Any, choose: Callable[[Draws], tuple[KnownRun, float | None]]) -> None:
        self._corpus, self.choose = corpus, choose

    def __getattr__(self, name: str) -> Any:
        return getattr(self._corpus, name)


class Meter:
    """Makes runs in this process, whole and from a snapshot, and adds up CPU time."""

    here = True

    def __init__(self) -> None:
        self.search: Family | None = None
        self.whole_s = self.branched_s = 0.0
        self.runs = self.moved = self.begun_later = 0
        self.skipped: list[float] = []  # of the moved runs: the share that need not be made again
        self.nearest: list[float] = []  # of the moved runs: when the margin of the other run was least, as a share

    def carry(self, modules: Modules) -> Modules:
        return modules

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        for task in tasks:
            began = time.process_time()
            row = make_run(task)
            whole = time.process_time() - began
            self.runs += 1
            self.whole_s += whole
            self.branched_s += self._branched(task, whole)
            take([{name: True if name.startswith("check.") else value for name, value in row.items()}])  # go on
            print(f"{self.runs} runs, whole {self.whole_s:.0f} s, with snapshots {self.branched_s:.0f} s", flush=True)

    def _branched(self, task: Task, whole: float) -> float:
        """The CPU time of the same run from a snapshot of its parent, if there is one."""
        assert self.search is not None
        known = self.search.parents.get(task.key)
        if known is None:
            return whole
        parent, near_s = known
        self.moved += 1
        child = parse_scenario(task.text, "child", [f"seed={task.seed}", EVERY])
        end_s = child.duration_ns / 1e9
        if near_s is not None:
            self.nearest.append(near_s / end_s)
        other = parse_scenario(json.dumps(parent.tree), "parent", [f"seed={parent.tree['seed']}", EVERY])
        same_s = first_difference(child, other) if parent.tree["seed"] == task.seed else 0.0
        at = int(min(same_s, end_s - 1.0)) * 1_000_000_000 // child.tick_ns
        self.skipped.append(at / child.ticks)
        if not at:
            return whole
        states: dict[int, bytes] = {}
        run(other, None, states)
        self.begun_later += 1
        began = time.process_time()
        run(child, Snapshot.from_bytes(states[max(tick for tick in states if tick <= at)]), {})
        return time.process_time() - began


class _States:
    """Keeps snapshots, and nothing else."""

    def __init__(self, states: dict[int, bytes]) -> None:
        self._states = states

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None: ...
    def packet(self, fate: Fate) -> None: ...
    def event(self, event: Event) -> None: ...

    def snapshot(self, snapshot: Snapshot) -> None:
        self._states[snapshot.tick] = snapshot.to_bytes()


def run(scenario: Scenario, snapshot: Snapshot | None, states: dict[int, bytes]) -> None:
    """Make a run with its checks, from a snapshot if there is one."""
    begin = 0 if snapshot is None else snapshot.tick
    journal = Journal(scenario, _States(states), checks=OwnChecks.asked(scenario, begin))
    runner = InProcess(scenario, journal, None if snapshot is None else Start(snapshot, ""))
    runner.serve(GrantPolicy.of(scenario, begin=begin), lambda: None)


def first_difference(a: Scenario, b: Scenario) -> float:
    """When the faults of two runs differ for the first time [s]."""
    events = [sorted((e.tick, e.action, e.what) for e in one.faults.events) for one in (a, b)]
    pairs = zip(*events, strict=False)
    first = next((min(x[0], y[0]) for x, y in pairs if x != y), None)
    if first is None:
        longer = max(events, key=len)[min(map(len, events)) :]
        first = longer[0][0] if longer else a.ticks
    return first * a.tick_ns / 1e9


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--runs", type=int, default=24)
    arguments = parser.parse_args()
    meter = Meter()
    scenario = load_scenario(arguments.scenario, ["faults=[]", "nemesis=swarm"])
    began = time.process_time()
    run(load_scenario(scenario.name, ["faults=[]"]), None, {})
    plain = time.process_time() - began
    began = time.process_time()
    run(load_scenario(scenario.name, ["faults=[]", EVERY]), None, {})
    often = time.process_time() - began
    meter.search = Family(scenario)
    meter.search.run(meter, lambda runs: None, arguments.runs)
    mean = lambda values: sum(values) / max(1, len(values))  # noqa: E731
    print(json.dumps({
        "scenario": scenario.name, "runs": meter.runs, "moved": meter.moved, "begun later": meter.begun_later,
        "skipped of moved": round(mean(meter.skipped), 3), "least margin at": round(mean(meter.nearest), 3),
        "whole s": round(meter.whole_s / meter.runs, 2), "branched s": round(meter.branched_s / meter.runs, 2),
        "snapshot each 10 s": round(plain, 2), "snapshot each second": round(often, 2),
    }))  # fmt: skip


if __name__ == "__main__":
    main()
