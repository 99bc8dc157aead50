"""The world's memory of a run before a tick. Another run can continue from it.

As MessagePack a memory is a map with one key, `vehicles`: an array of `VehicleMemory`, ascending by number.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

DIVERGED = "diverged"


class Tumbling(NamedTuple):
    """How often a vehicle has tumbled, and when the last time."""

    tumbled: int  # 1 while it is tumbled, else 0
    number: int  # how often it has tumbled, this time included
    since: int  # tick at which it began the last time


class VehicleMemory(NamedTuple):
    """One vehicle before a tick."""

    vehicle: int  # its number
    motion: list[Any]  # of `World.memory`
    tau: list[float]  # the last command that took effect [N, N m]
    delayed: list[list[Any]]  # [tick, tau] of commands that wait because the agent is slow
    condition: str | list[int] | bool  # DIVERGED, a `Tumbling`, or False; logs of old versions have True as well
    agent: bytes | None  # what its agent remembers; none without an agent; None: the agent has not sent it yet

    @property
    def diverged(self) -> bool:
        """Whether the vehicle is not integrated any more."""
        return self.condition == DIVERGED

    @property
    def tumbling(self) -> Tumbling | None:
        """How it tumbled; None: it has not, or it diverged."""
        return Tumbling(*self.condition) if isinstance(self.condition, list) else None


def vehicle_memories(memory: dict[str, Any]) -> Iterator[VehicleMemory]:
    """The vehicles in a memory, by number."""
    return map(VehicleMemory._make, memory["vehicles"])
