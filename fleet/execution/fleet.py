"""A running fleet as its operator and its supervisor see it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from fleet.scenario.sections.timeline import Kill
from netem.faults import NetFault
from netem.lives import Absence
from netem.wire.messages import Death, Restart, WorldFault


class Disturbed(Protocol):
    """A running fleet: the questions that an operator asks, and the changes that he makes.

    `Console` and `InProcess` are such fleets.
    """

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

    def without_agent(self) -> list[int]:
        """The vehicles that have no agent now."""

    def end_agents(self, kill: Kill) -> None:
        """End agents because the operator asks for it."""

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        """Start vehicle i's agent again at a tick; it has been missing since tick `begin` (None: whenever)."""


class Fleet(Disturbed, Protocol):
    """The same as its supervisor sees it, on the console's main thread; `Console` is one."""

    @property
    def begun(self) -> bool:
        """Whether everyone was ready and the clock runs. Before that no agent may end."""

    def ask(self, role: str, op: str, **fields: Any) -> dict[str, Any]:
        """The answer of world or netem to an operation; empty: no answer in time."""

    def set_absences(self, absences: Sequence[Absence]) -> None:
        """Replace what netem knows of who has an agent when. Raises RunBroken: it did not answer."""

    def announce(self, message: Death | Restart) -> None:
        """Notify the world that an agent ended or begins again."""

    def computing(self, role: str) -> int:
        """The vehicle whose agent a host computes, or computed when it ended. 0: no vehicle, or not a host."""

    def start_agent(self, i: int, incarnation: int, begin: int) -> None:
        """Start the next life of vehicle i's agent, from tick `begin` on."""
