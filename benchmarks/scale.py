"""`python -m benchmarks scale`: the CPU time that a tick of an agent takes, by the size of the fleet."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field

import psutil
from msgspec import Struct

from benchmarks.soak import pss_mb
from fleet.errors import FleetError, RunBroken
from fleet.execution.clock import GrantPolicy
from fleet.execution.console import Console
from fleet.execution.directory import RunDirectory
from fleet.execution.hosting import hosting
from fleet.execution.in_process import InProcess
from fleet.execution.options import Options
from fleet.execution.wiring import USUAL
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import LogWriter
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from netem.clock import Clock
from netem.private_folder import PrivateFolder

AGENT_TICKS = 20_000  # of a run, about
LEAST_TICKS, MOST_TICKS = 30, 1000
WEIGHED = 20  # agents whose memory is looked at
ROLES = ("console", "world", "netem", "agents")
BEGINNINGS = {
    "world": ("fleet world",),
    "netem": ("fleet netem",),
    "agents": ("fleet agent", "fleet host"),
}  # of titles


class ScaleRow(Struct, frozen=True):
    """One fleet size, with a log of every tick; CPU times are per agent and tick."""

    vehicles: int
    tick_ms: float
    in_process_us: float
    distributed_us: dict[str, float]  # by role; all agents together
    ready_s: float  # wall time until every process was ready
    x_real_time: float  # of the distributed run
    agent_mb: float  # PSS of the agents' processes, per agent
    all_mb: float  # PSS of all processes
    per_process: int  # agents in a process, at most

    @property
    def total_us(self) -> float:
        """CPU time of all processes of the distributed run per agent and tick."""
        return sum(self.distributed_us.values())


HEADING = (
    "CPU time per agent and tick [us]; tick and ready on the wall clock; PSS\n"
    "   N  per  tick  in-process  distributed  agents  world  netem  console  x real  ready  agent   all\n"
    "     proc. [ms]                                                           time    [s]   [MB]  [MB]"
)


def line(row: ScaleRow) -> str:
    """A row below `HEADING`."""
    us = row.distributed_us
    return (
        f"{row.vehicles:4d} {row.per_process:4d} {row.tick_ms:5g} {row.in_process_us:11.0f} {row.total_us:12.0f} "
        f"{us['agents']:7.0f} {us['world']:6.0f} {us['netem']:6.0f} {us['console']:8.0f} {row.x_real_time:7.2f} "
        f"{row.ready_s:6.1f} {row.agent_mb:6.1f} {row.all_mb:5.0f}"
    )


@dataclass(slots=True)
class _Meter:
    """Reads CPU times when a tenth of the ticks is there, and again at nine tenths; called as a run shows progress."""

    journal: Journal
    ticks: int
    vehicles: int
    cpu_s: Counter[str] = field(default_factory=Counter)  # between the two
    passed: int = 0  # ticks between them
    wall_s: float = 0.0
    agent_mb: float = 0.0
    all_mb: float = 0.0
    _first: tuple[int, float, Counter[str]] | None = None

    def __call__(self) -> None:
        framed = self.journal.framed
        if self._first is None and framed >= self.ticks // 10:
            found = _cpu_times()
            self._first = framed, time.monotonic(), found
        elif self._first is not None and not self.passed and framed >= self.ticks * 9 // 10:
            begun, at, before = self._first
            self.wall_s = time.monotonic() - at
            self.cpu_s = Counter(_cpu_times())
            self.cpu_s.subtract(before)
            self.passed = framed - begun
            self._weigh()

    def _weigh(self) -> None:
        sizes: dict[str, list[int]] = {}
        for role, process in _processes():
            sizes.setdefault(role, []).append(process.pid)
        agents = sizes.pop("agents", [])
        some = [pss_mb(pid) for pid in agents[:: max(1, len(agents) // WEIGHED)]]
        all_agents = sum(some) / max(1, len(some)) * len(agents)
        self.agent_mb = all_agents / self.vehicles
        self.all_mb = all_agents + sum(pss_mb(pid) for pids in sizes.values() for pid in pids)

    def per_agent_tick_us(self) -> dict[str, float]:
        """CPU time by role, in microseconds.

        Raises:
            FleetError: the run was over before it could be measured.
        """
        if not self.passed:
            raise FleetError(f"the run with {self.vehicles} vehicles ended before it could be measured", status=3)
        each = self.passed * self.vehicles
        return {role: self.cpu_s[role] * 1e6 / each for role in ROLES if role in self.cpu_s}


def measure_scale(
    sizes: Sequence[int], tick: str, per_process: str, *, quick: bool, say: Callable[[str], None]
) -> Iterator[ScaleRow]:
    """Each row as soon as it is measured.

    Args:
        tick: of the scenario, as text with a unit.
        per_process: agents in a process, as in a scenario.

    Raises:
        ScenarioError: the paper's scenario cannot have this tick.
        FleetError: a run did not come to its end.
    """
    for n in sizes:
        ticks = LEAST_TICKS if quick else min(max(AGENT_TICKS // n, LEAST_TICKS), MOST_TICKS)
        settings = [f"vehicles={n}", f"tick={tick}", "checks={tumbled: waived}"]
        settings.append(f"agents.per_process={per_process}")
        tick_ns = load_scenario("paper", settings).tick_ns
        scenario = load_scenario("paper", [*settings, f"duration={ticks * tick_ns / 1e9:g} s"])
        say(f"N = {n}: in process, {ticks} ticks")
        alone, _ = _measured(scenario, in_process=True)
        say(f"N = {n}: distributed, {ticks} ticks")
        apart, ready_s = _measured(scenario, in_process=False)
        yield ScaleRow(
            vehicles=n,
            tick_ms=tick_ns / 1e6,
            in_process_us=sum(alone.per_agent_tick_us().values()),
            distributed_us=apart.per_agent_tick_us(),
            ready_s=ready_s,
            x_real_time=apart.passed * tick_ns / 1e9 / apart.wall_s,
            agent_mb=apart.agent_mb,
            all_mb=apart.all_mb,
            per_process=hosting(scenario, Clock.LOCKSTEP).processes_used(scenario)[1],
        )


def _measured(scenario: Scenario, *, in_process: bool) -> tuple[_Meter, float]:
    """The measurement, and the time until all were ready [s]."""
    with PrivateFolder("bench") as out:
        options = Options(out, in_process=in_process, quiet=True)
        with closing(RunDirectory(options.out, scenario.name, scenario.seed)) as directory:
            file = LogFile(directory.log)
            journal = Journal(scenario, LogWriter(file, scenario))
            meter = _Meter(journal, scenario.ticks, scenario.vehicles)
            try:
                if in_process:
                    InProcess(scenario, journal).serve(GrantPolicy.of(scenario), meter)
                    return meter, 0.0
                shared = hosting(scenario, options.clock)
                console = Console(scenario, directory, journal, options, USUAL, shared, "5ca1e", lambda _: None)
                console.serve(GrantPolicy.of(scenario), meter)
                return meter, console.started_s
            except RunBroken as error:
                lines = "; ".join(error.lines[:3])
                raise FleetError(
                    f"the run with {scenario.vehicles} vehicles broke: {error.reason}; {lines}", status=3
                ) from None
            finally:
                file.close()


def _processes() -> Iterator[tuple[str, psutil.Process]]:
    """The processes of the run by role, without the console."""
    for process in psutil.Process().children(recursive=True):
        title = " ".join(process.cmdline())
        for role, begins in BEGINNINGS.items():
            if title.startswith(begins):
                yield role, process


def _cpu_times() -> Counter[str]:
    """CPU time so far [s], user and system, by role."""
    found = Counter({"console": time.process_time()})
    for role, process in _processes():
        times = process.cpu_times()
        found[role] += times.user + times.system
    return found
