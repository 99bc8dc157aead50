"""`fleet bench`: how fast this machine is, as ratios against baselines measured in the same minute.

(a) a bare zenoh barrier: the same router, credentials and sessions, N echo agents that compute nothing;
(b) the same barrier over OS pipes, the physical floor;
(c) the paper's scenario distributed, with recording;  (d) the same in one process.

The figures of a single process are compared with a loop of plain Python (`fleet.bench.python_loop`). Everything is
measured several times, in turn, so that a slow minute of the machine meets a figure and its baseline alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from fleet.bench import python_loop
from fleet.bench.agent_step import GOALS_US
from fleet.bench.barriers import pipe_barrier, zenoh_barrier
from fleet.bench.figures import Collector, Measured, now, this_machine
from fleet.bench.journal import measure_recorder
from fleet.bench.measured_run import measured_run
from fleet.bench.memory import sampled_pss
from fleet.bench.navigation_step import GOAL_US, name_of
from fleet.bench.network_core import SHARE, SHARE_GOAL, netem_figures
from fleet.bench.policies import policy_steps
from fleet.bench.start_up import COMMANDS, PYTHON, cpu_times
from fleet.bench.steps import steps
from fleet.execution.options import Options
from fleet.result.result import Wall
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.navigation import shipped_grades
from netem.private_folder import PrivateFolder

TICK_S = 0.01
REPEATS = 5
ZENOH, PIPES = "a zenoh barrier", "b pipe barrier"
DISTRIBUTED, IN_PROCESS, CPU = "c distributed", "d in-process", "d CPU time of a tick"
READY, PSS = "ready", "PSS of an agent"
# Four vehicles at the rates at which others are used; a round is a whole number of ticks.
RATES: dict[str, tuple[str, ...]] = {
    "tick 10 ms, round 100 ms": (),
    "tick 100 ms, round 200 ms": ("tick=100 ms", "network.period=200 ms", "guidance.qp_period=100 ms"),
}
_JOURNAL_SIZES = {"mb_per_minute": "MB/min", "mb_per_vehicle_minute": "MB/min of a vehicle"}
_STEPS, _START = "step: ", "start: "
# Name of a figure, whether its ratio is meant, and what was asked of it: at least, or where less is better at most.
GOALS: list[tuple[str, bool, float]] = [
    (f"N = 4: {DISTRIBUTED}", True, 0.35),
    (f"N = 4: {DISTRIBUTED}", False, 1500.0),
    (f"N = 4: {IN_PROCESS}", False, 4000.0),
    (f"N = 4: {READY}", False, 0.5),
    ("N = 4: journal written", False, 400e3),
    (f"N = 100: {DISTRIBUTED}", False, 100.0),
    (f"N = 100: {IN_PROCESS}", False, 300.0),
    (f"N = 100: {PSS}", False, 12.0),
    ("N = 100: journal written", False, 400e3),
    *((f"{_STEPS}{name}", False, goal) for name, goal in GOALS_US.items()),
    *((f"{_STEPS}{name_of(grade)}", False, GOAL_US) for grade in shipped_grades()),
    (f"network core: {SHARE}", False, SHARE_GOAL),
    (f"{_START}fleet --help", False, 0.1),
]


def measure_fleets(sizes: list[int], *, quick: bool, say: Callable[[str], None]) -> Measured:
    """Run every benchmark; `say` is called with what is measured next.

    Raises:
        FleetError: a measurement did not come to its end.
    """
    machine, began = this_machine(), now()
    found = Collector()
    repeats = 1 if quick else REPEATS
    for n in sizes:
        for number in range(1, repeats + 1):
            _fleet(n, quick, found, lambda what, n=n, k=number: say(f"N = {n}, {k} of {repeats}: {what}"))  # type: ignore[misc]
    for number in range(1, repeats + 1):
        say(f"four vehicles at other rates, {number} of {repeats}")
        _rates(quick, found)
    for n in sizes:
        for number in range(1, repeats + 1):
            _journal(n, quick, found, lambda what, k=number: say(f"{what}, {k} of {repeats}"))  # type: ignore[misc]
    for number in range(1, repeats + 1):
        say(f"the network core, start-up, single steps and policies, {number} of {repeats}")
        _network_core(quick, found)
        _start_up(quick, found)
        _single_steps(quick, found)
        _policies(quick, found)
    return found.measured(quick=quick, machine=machine, began=began)


def _fleet(n: int, quick: bool, found: Collector, say: Callable[[str], None]) -> None:
    """One measurement of a fleet and of its baselines."""
    name, ticks = f"N = {n}: ", 50 if quick else max(100, 4_000 // n)
    scenario = _scenario(n, quick)
    say("barriers")
    zenoh, pipes, loops = zenoh_barrier(n, ticks), pipe_barrier(n, ticks), python_loop.loops_per_s()
    say(f"distributed, {scenario.ticks} ticks")
    with sampled_pss() as pss:
        distributed = _wall(scenario, in_process=False)
    say("in-process")
    cpu_s = time.process_time()
    alone = _wall(scenario, in_process=True)
    tick_us = (time.process_time() - cpu_s) / scenario.ticks * 1e6  # with what a run does once
    found.add(name + ZENOH, "ticks/s", zenoh, of_machine=True)
    found.add(name + PIPES, "ticks/s", pipes, of_machine=True)
    found.add(name + DISTRIBUTED, "ticks/s", scenario.ticks / distributed.run_s, ZENOH, zenoh)
    found.add(name + IN_PROCESS, "ticks/s", scenario.ticks / alone.run_s, python_loop.NAME, loops)
    found.add(name + CPU, "us", tick_us, python_loop.NAME, 1e6 / loops, higher=False)
    found.add(name + READY, "s", distributed.startup_s, python_loop.NAME, 1 / loops, higher=False)
    if pss[0]:  # a run of half a second was not seen
        found.add(name + PSS, "MB", pss[0], higher=False)


def _rates(quick: bool, found: Collector) -> None:
    for name, changes in RATES.items():
        scenario = _paper(4, 2.0 if quick else 60.0, *changes)
        loops, simulated_s = python_loop.loops_per_s(), scenario.duration_ns / 1e9
        for how, in_process in ((DISTRIBUTED, False), (IN_PROCESS, True)):
            speed = simulated_s / _wall(scenario, in_process=in_process).run_s
            found.add(f"four vehicles: {name}, {how}", "x real time", speed, python_loop.NAME, loops)


def _journal(n: int, quick: bool, found: Collector, say: Callable[[str], None]) -> None:
    loops = python_loop.loops_per_s()
    for key, value in measure_recorder(_scenario(n, quick), say).items():
        name = f"N = {n}: journal {key}"
        if key in _JOURNAL_SIZES:
            found.add(name, _JOURNAL_SIZES[key], value, higher=False)
        elif key == "messages":
            found.add(name, "messages", value, higher=False)
        elif key != "vehicles":
            found.add(name, "messages/s", value, python_loop.NAME, loops)


def _network_core(quick: bool, found: Collector) -> None:
    loops = python_loop.loops_per_s()
    for name, value in netem_figures(quick=quick).items():
        if name == SHARE:
            found.add(f"network core: {name}", "1", value, higher=False)
        elif name != "vehicles":
            found.add(f"network core: {name.removesuffix(', packets/s')}", "packets/s", value, python_loop.NAME, loops)


def _start_up(quick: bool, found: Collector) -> None:
    times = cpu_times(1 if quick else 3)
    for name in COMMANDS:
        python = name == PYTHON
        baseline = () if python else (PYTHON, times[PYTHON])
        found.add(f"{_START}{name}", "s of CPU time", times[name], *baseline, higher=False, of_machine=python)


def _single_steps(quick: bool, found: Collector) -> None:
    loops = python_loop.loops_per_s()
    for name, us in steps(50 if quick else 600).items():
        found.add(f"{_STEPS}{name.strip()}", "us", us, python_loop.NAME, 1e6 / loops, higher=False)


def _policies(quick: bool, found: Collector) -> None:
    loops = python_loop.loops_per_s()
    for name, steps_per_s in policy_steps(quick=quick).items():
        found.add(f"policies: {name}", "steps/s", steps_per_s, python_loop.NAME, loops)


def _scenario(n: int, quick: bool) -> Scenario:
    seconds = 0.5 if quick else 20 if n <= 4 else 8 if n <= 20 else 4
    return _paper(n, seconds, *(["log.every=10 ticks"] if n >= 100 else []))


def _paper(n: int, seconds: float, *changes: str) -> Scenario:
    # A process each, as in the barriers; `fleet bench scale` measures fleets whose agents share processes.
    settings = [f"vehicles={n}", f"duration={seconds} s", "checks={tumbled: waived}", "agents.per_process=1"]
    return load_scenario("paper", [*settings, *changes])


def _wall(scenario: Scenario, *, in_process: bool) -> Wall:
    with PrivateFolder("bench") as out:
        return measured_run(scenario, Options(out, in_process=in_process, quiet=True)).wall


def goals(measured: Measured) -> list[str]:
    """Each goal that was measured, met or missed and by how much."""
    lines = []
    for name, of_ratio, goal in GOALS:
        figure = measured.figure(name)
        if figure is None:
            continue
        value = figure.ratio if of_ratio else figure.best
        met = value >= goal if figure.higher_is_better else value <= goal
        limit = f"at {'least' if figure.higher_is_better else 'most'} {goal:g}"
        what = f"{name} / {figure.baseline}" if of_ratio else name
        unit = "" if of_ratio or figure.unit == "1" else f" {figure.unit}"
        lines.append(f"{'met   ' if met else 'MISSED'} {what}: {value:,.{2 if value < 100 else 0}f}{unit}, {limit}")
    return lines
