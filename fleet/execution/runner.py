"""What a run in one process and a run as a fleet of processes have in common.

`Runner` is for whoever makes the run: it carries out the run to its end. `Fleet` is for its operator meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from fleet.execution.clock import GrantPolicy
from fleet.execution.directory import RunDirectory
from fleet.recorder.journal import Journal
from fleet.recorder.log_file import LogFile, NoLog
from fleet.result.verdict import Verdict
from fleet.scenario.faults.kind import Kill
from fleet.scenario.scenario import Scenario
from netem.condition import Link
from netem.faults import NetFault
from netem.wire.messages import WorldFault


@dataclass(slots=True)
class Closing:
    """The final reports of a run's processes; parts are empty if the run ended early."""

    entered: dict[Link, tuple[int, int]] = field(default_factory=dict)  # packets sent on each link, and duplicates
    rejected: dict[str, int] = field(default_factory=dict)  # by key, messages that were refused
    timing: dict[str, Any] = field(default_factory=dict)  # who was how late in a realtime run
    verdicts: list[Verdict] = field(default_factory=list)  # of what only the runner sees, such as programs of others
    cpu_s: float = 0.0  # CPU time of all processes, of a run of programs that are not ours


class Runner(Protocol):
    """Carries out one run."""

    @property
    def waiting(self) -> str:
        """The processes that the run waits for, in words. Empty: the run moves."""

    started_s: float  # wall time until everyone was ready [s]
    closing: Closing
    notes: list[str]
    deaths: dict[int, list[str]]  # by vehicle, how agents ended that were not asked to
    middleware_lost: int  # messages that zenoh lost; any makes the run invalid

    def serve(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Run to the end; `progress` is called all the time. Raises RunBroken if the run could not be completed;
        StoppedError if the operator stopped it.
        """


# Makes the run of a scenario with nodes, with the run's id, and what shows the operator a line that stays.
MakeRelay = Callable[[Scenario, RunDirectory, Journal, LogFile | NoLog, str, Callable[[str], None]], Runner]


class Fleet(Protocol):
    """A running fleet: what an operator asks of it, and changes in it. `Supervisor` and `InProcess` are such fleets."""

    @property
    def granted(self) -> int:
        """The grant: a tick. Earlier ticks may have begun."""

    @property
    def waiting(self) -> str:
        """The processes that the run waits for, in words. Empty: the run moves."""

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        """Replace netem's faults; False: it did not answer, and nothing was changed."""

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        """Replace the world's faults before the first tick that is not granted yet."""

    def vehicles_without_agent(self) -> list[int]:
        """The vehicles that have no agent now."""

    def end_agents(self, kill: Kill) -> None:
        """End agents because the operator asks for it."""

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        """Start vehicle i's agent again at a tick; it has been missing since tick `begin` (None: whenever)."""
