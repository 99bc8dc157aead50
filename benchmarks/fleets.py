"""The figures of `python -m benchmarks`, as ratios to baselines that are measured in the same minute.

(a) a bare zenoh barrier: the same router, credentials and sessions, N echo agents that compute nothing;
(c) the paper's scenario distributed, with recording;  (d) the same in one process.

Figures of a single process are compared with a loop of plain Python, those of start-up with Python's own. Everything
is measured several times, in turn, so that a slow minute of the machine meets a figure and its baseline alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from benchmarks.barriers import LOOP, ZENOH, loops_per_s, zenoh_barrier
from benchmarks.figures import Collector, Measured
from benchmarks.recorder import recorder_figures
from benchmarks.start_up import COMMANDS, PYTHON, cpu_times
from fleet.errors import FleetError
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Status, Wall
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from netem.private_folder import PrivateFolder

REPEATS = 5
DISTRIBUTED, IN_PROCESS, CPU = "c distributed", "d in-process", "d CPU time of a tick"
READY = "ready"
# Four vehicles at the rates at which others are used; a round is a whole number of ticks.
RATES: dict[str, tuple[str, ...]] = {
    "tick 10 ms, round 100 ms": (),
    "tick 100 ms, round 200 ms": ("tick=100 ms", "network.period=200 ms", "guidance.qp_period=100 ms"),
}


def measure_fleets(sizes: list[int], *, quick: bool, say: Callable[[str], None]) -> Measured:
    """Run every benchmark; `say` is called with what is measured next.

    Raises:
        FleetError: a measurement did not come to its end.
    """
    found = Collector(quick=quick)
    work: list[tuple[str, Callable[[], None]]] = [
        *((f"N = {n}: fleet", lambda n=n: _fleet(n, quick, found)) for n in sizes),  # type: ignore[misc]
        ("four vehicles at other rates", lambda: _rates(quick, found)),
        *((f"N = {n}: journal", lambda n=n: _journal(n, quick, found)) for n in sizes),  # type: ignore[misc]
        ("start-up", lambda: _start_up(quick, found)),
    ]
    repeats = 1 if quick else REPEATS
    for what, measure in work:
        for number in range(1, repeats + 1):
            say(f"{what}, {number} of {repeats}")
            measure()
    return found.measured


def _fleet(n: int, quick: bool, found: Collector) -> None:
    name, scenario = f"N = {n}: ", _scenario(n, quick)
    zenoh, loops = zenoh_barrier(n, 50 if quick else max(100, 4_000 // n)), loops_per_s()
    distributed = _wall(scenario, in_process=False)
    cpu_s = time.process_time()
    alone = _wall(scenario, in_process=True)
    tick_us = (time.process_time() - cpu_s) / scenario.ticks * 1e6  # with what a run does once
    found.add(name + ZENOH, "ticks/s", zenoh, of_machine=True)
    found.add(name + DISTRIBUTED, "ticks/s", scenario.ticks / distributed.run_s, (ZENOH, zenoh))
    found.add(name + IN_PROCESS, "ticks/s", scenario.ticks / alone.run_s, (LOOP, loops))
    found.add(name + CPU, "us", tick_us, (LOOP, 1e6 / loops), higher=False)
    found.add(name + READY, "s", distributed.startup_s, (LOOP, 1 / loops), higher=False)


def _rates(quick: bool, found: Collector) -> None:
    for name, changes in RATES.items():
        scenario = _paper(4, 2.0 if quick else 60.0, *changes)
        loops, simulated_s = loops_per_s(), scenario.duration_ns / 1e9
        for how, in_process in ((DISTRIBUTED, False), (IN_PROCESS, True)):
            speed = simulated_s / _wall(scenario, in_process=in_process).run_s
            found.add(f"four vehicles: {name}, {how}", "x real time", speed, (LOOP, loops))


def _journal(n: int, quick: bool, found: Collector) -> None:
    loops = loops_per_s()
    for key, (value, unit) in recorder_figures(_scenario(n, quick)).items():
        speed = unit == "messages/s"
        found.add(f"N = {n}: journal {key}", unit, value, (LOOP, loops) if speed else ("", 0.0), higher=speed)


def _start_up(quick: bool, found: Collector) -> None:
    times = cpu_times(1 if quick else 3)
    for name in COMMANDS:
        python = name == PYTHON
        baseline = ("", 0.0) if python else (PYTHON, times[PYTHON])
        found.add(f"start: {name}", "s of CPU time", times[name], baseline, higher=False, of_machine=python)


def _scenario(n: int, quick: bool) -> Scenario:
    seconds = 0.5 if quick else 20 if n <= 4 else 8 if n <= 20 else 4
    return _paper(n, seconds, *(["log.every=10 ticks"] if n >= 100 else []))


def _paper(n: int, seconds: float, *changes: str) -> Scenario:
    # A process each, as in the barrier; `scale` measures fleets whose agents share processes.
    settings = [f"vehicles={n}", f"duration={seconds} s", "checks={tumbled: waived}", "agents.per_process=1"]
    return load_scenario("paper", [*settings, *changes])


def _wall(scenario: Scenario, *, in_process: bool) -> Wall:
    with PrivateFolder("bench") as out:
        result = execute(scenario, Options(out, in_process=in_process, quiet=True))
    if result.status is Status.PASS:
        return result.wall
    status = 3 if result.status in (Status.BROKEN, Status.CHECK_FAILED) else result.status.exit
    reason = f"the run with {scenario.vehicles} vehicles ended: {result.status}"
    raise FleetError(f"{reason}{f', {result.reason}' if result.reason else ''}", status=status)
