"""The input of checks and measures at a tick: the values of every vehicle's signals, as the log has them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from fleet.checks.belief import belief_values
from fleet.checks.located import located_values
from fleet.scenario.sections.signals import ROLL
from netem.wire.messages import Command, Frame, VehicleFrame
from world.vectors import Vec3

Values = tuple[float, ...]
ROLL_SIZE = len(ROLL)


class Error(Protocol):
    """How far a vehicle is from where it should be, by both measures [m, NED]."""

    @property
    def e(self) -> Vec3: ...
    @property
    def e_norm(self) -> float: ...
    @property
    def formation(self) -> Vec3: ...
    @property
    def formation_norm(self) -> float: ...


class TickValues(Protocol):
    """The values of one tick."""

    @property
    def tick(self) -> int: ...

    def values(self, i: int, group: str) -> Values:
        """The values of a topic group of vehicle i, flat; empty if the log has no sample of it at this tick."""


def values_of(group: str, row: VehicleFrame, command: Command | None, error: Error) -> Values:
    """The values of a topic group of a vehicle, flat; empty if there are none."""
    match group:
        case "state":
            return (*row.eta, *row.nu, *row.plant[:ROLL_SIZE])
        case "plant":
            return tuple(row.plant[ROLL_SIZE:])
        case "clock":
            return tuple(row.clock)
        case "nav":
            return tuple(row.nav)
        case "belief":
            return belief_values(row, error)
        case "located":
            return () if command is None else located_values(row, command.telemetry)
        case "error":
            return (*error.e, error.e_norm, *error.formation, error.formation_norm)
        case "command":
            return () if command is None else (*command.tau, *row.tau)
        case _:
            return () if command is None else command.telemetry


class FrameValues:
    """The values of a frame, of the groups with a sample in the log at its tick."""

    def __init__(
        self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, Error], due: frozenset[str]
    ) -> None:
        self.tick = frame.tick
        self._rows, self._commands, self._errors, self._due = frame.vehicles, commands, errors, due

    def values(self, i: int, group: str) -> Values:
        """The values of a topic group of vehicle i."""
        if group not in self._due:
            return ()
        return values_of(group, self._rows[i - 1], self._commands.get(i), self._errors[i])


class LoggedValues:
    """The values of a tick as they were read from a log."""

    def __init__(self, tick: int, found: Mapping[tuple[int, str], Values]) -> None:
        """`found`: by vehicle and topic group."""
        self.tick = tick
        self._found = found

    def values(self, i: int, group: str) -> Values:
        """The values of a topic group of vehicle i."""
        return self._found.get((i, group), ())
