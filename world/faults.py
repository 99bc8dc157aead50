"""Faults of sensors, actuators and sea with a beginning and an end: what they do to one vehicle at a tick.

| kind | values | what |
|---|---|---|
| noise | sigma of position [m], angle [rad], velocity [m/s], rate [rad/s] | white noise on top of the sensor's own |
| bias | ten numbers on eta and nu [m, rad, m/s, rad/s] | added to what is measured |
| freeze | | the measurement of the tick at which it began, again and again |
| efficiency | three factors | of what the actuators make of a command |
| saturate | three limits [N, N m, N m] | in place of the actuators' own where they are smaller |
| off, stuck | | no force at all; the force of the tick at which it began |
| current | x, y, z [m/s, NED] | added to the sea's own, for every vehicle |
| wrench | five forces and moments [N, N m, body] | added to the disturbance |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

WorldFaultKind = Literal["noise", "bias", "freeze", "efficiency", "saturate", "off", "stuck", "current", "wrench"]


@dataclass(frozen=True, slots=True)
class WorldFault:
    """One fault: from tick `begin` to before `end` (None: to the end of the run)."""

    id: str
    begin: int
    end: int | None
    kind: WorldFaultKind
    vehicles: tuple[int, ...] = ()  # none: all
    values: tuple[float, ...] = ()

    def active(self, tick: int) -> bool:
        """Whether it holds at a tick."""
        return self.begin <= tick and (self.end is None or tick < self.end)

    def concerns(self, i: int) -> bool:
        """Whether it is about vehicle i."""
        return not self.vehicles or i in self.vehicles

    def to_values(self) -> list[Any]:
        """Plain values."""
        return [self.id, self.begin, self.end, self.kind, list(self.vehicles), list(self.values)]

    @classmethod
    def from_values(cls, values: list[Any]) -> WorldFault:
        """The inverse of `to_values`."""
        name, begin, end, kind, vehicles, numbers = values
        return cls(name, begin, end, kind, tuple(vehicles), tuple(float(x) for x in numbers))
