"""`fleet bench`: how fast this machine is, as ratios against two baselines measured in the same run.

(a) a bare zenoh barrier: the same router, credentials and sessions, N echo agents that compute nothing;
(b) the same barrier over OS pipes, the physical floor;
(c) the paper's scenario distributed, with recording;  (d) the same in one process.
"""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fleet.bench.agent_step import GOALS_US
from fleet.bench.barriers import pipe_barrier, zenoh_barrier
from fleet.bench.journal import measure_recorder
from fleet.bench.measured_run import measured_run
from fleet.bench.memory import sampled_pss
from fleet.bench.network_core import SHARE, SHARE_GOAL, netem_figures
from fleet.bench.start_up import measure_start_up
from fleet.bench.steps import steps
from fleet.run.options import Options
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario

TICK_S = 0.01
REPEATS = 3
START_UPS = 10
# (ratio or value of the issue that asked for it, by N); None where nothing was asked.
TARGETS = {"c/a": {4: 0.5}, "x real time": {4: 15.0, 100: 0.3}, "startup_s": {100: 2.0}, "pss_mb": {100: 12.0}}


@dataclass(slots=True)
class FleetRow:
    """The figures of one fleet size; ticks per wall second."""

    vehicles: int
    zenoh_barrier: float
    pipe_barrier: float
    distributed: float
    in_process: float
    startup_s: float
    pss_mb: float  # mean over the agent processes

    @property
    def x_real_time(self) -> float:
        return self.distributed * TICK_S

    def to_values(self) -> dict[str, Any]:
        return {
            **asdict(self),
            "x_real_time": self.x_real_time,
            "c/a": self.distributed / self.zenoh_barrier,
            "c/d": self.distributed / self.in_process,
        }


def measure_fleets(sizes: list[int], *, quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """Run every benchmark; `say` is called with what is measured next.

    Raises:
        BenchError: a measurement did not come to its end.
    """
    rows = []
    for n in sizes:
        ticks = 50 if quick else max(300, 12_000 // n)
        say(f"N = {n}: zenoh barrier")
        zenoh = max(zenoh_barrier(n, ticks) for _ in range(1 if quick else REPEATS))
        say(f"N = {n}: pipe barrier")
        pipes = max(pipe_barrier(n, ticks) for _ in range(1 if quick else REPEATS))
        scenario = _scenario(n, quick)
        say(f"N = {n}: distributed, {scenario.ticks} ticks")
        with sampled_pss() as pss:
            distributed = _wall(scenario, in_process=False)
        say(f"N = {n}: in-process")
        alone = _wall(scenario, in_process=True)
        rows.append(
            FleetRow(
                vehicles=n,
                zenoh_barrier=zenoh,
                pipe_barrier=pipes,
                distributed=scenario.ticks / distributed["run_s"],
                in_process=scenario.ticks / alone["run_s"],
                startup_s=distributed["startup_s"],
                pss_mb=pss[0],
            )
        )
    journals = [measure_recorder(_scenario(n, quick), say) for n in sizes]
    say("the network core")
    network = netem_figures(quick=quick)
    say("start-up")
    start_up = measure_start_up(1 if quick else START_UPS)
    say("single steps")
    return {
        "machine": {"cpus": os.cpu_count(), "system": platform.platform(), "python": platform.python_version()},
        "versions": {name: version(name) for name in ("uuv-fleet", "eclipse-zenoh", "piqp", "numpy", "mcap")},
        "fleets": [row.to_values() for row in rows],
        "journals": journals,
        "netem": network,
        "start_up": start_up,
        "steps_us": steps(50 if quick else 2000),
    }


def _scenario(n: int, quick: bool) -> Scenario:
    seconds = 0.5 if quick else 60 if n <= 4 else 20 if n <= 20 else 10
    overrides = [f"vehicles={n}", f"duration={seconds} s", "checks={tumbled: waived}"]
    if n >= 100:
        overrides.append("log.every=10 ticks")
    return load_scenario("paper", overrides)


def _wall(scenario: Scenario, *, in_process: bool) -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="uuv-fleet-bench-") as out:
        result = measured_run(scenario, Options(Path(out), in_process=in_process, quiet=True))
    wall: dict[str, float] = result.values["wall"]
    return wall


def targets(rows: list[dict[str, Any]]) -> list[str]:
    """Each target, met or missed and by how much."""
    lines = []
    for row in rows:
        n = row["vehicles"]
        for name, by_size in TARGETS.items():
            if n in by_size:
                found, wanted = row[name.replace(" ", "_")], by_size[n]
                most = name in ("startup_s", "pss_mb")
                met = found <= wanted if most else found >= wanted
                sign = "at most" if most else "at least"
                lines.append(f"{'met   ' if met else 'MISSED'} N = {n}: {name} {found:.2f}, {sign} {wanted:g}")
    return lines


def step_targets(steps_us: dict[str, float]) -> list[str]:
    """The same for single steps of an agent."""
    return [
        f"{'met   ' if steps_us[name] <= goal else 'MISSED'} {name}: {steps_us[name]:.1f} us, at most {goal:g} us"
        for name, goal in GOALS_US.items()
    ]


def netem_targets(figures: dict[str, float]) -> list[str]:
    """The same for the network core's share of a run."""
    share = figures[SHARE]
    return [f"{'met   ' if share < SHARE_GOAL else 'MISSED'} netem: {SHARE} {share:.3f}, below {SHARE_GOAL:g}"]
