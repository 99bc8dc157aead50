"""Faults of sensors, actuators and sea, each with a beginning and an end.

| kind | values | what it does to a vehicle |
|---|---|---|
| noise | sigma of position [m], angle [rad], velocity [m/s], rate [rad/s] | white noise on top of the sensor's own |
| bias | twelve numbers on eta, nu, phi and p [m, rad, m/s, rad/s] | added to what is measured |
| freeze | | the sensor repeats the measurement of the tick at which the fault began |
| dropout | probability | of a tick at which the sensor repeats its last measurement |
| efficiency | three factors | multiply the force and moments that the actuators apply |
| saturate | three limits [N, N m, N m] | in place of the actuators' own where they are smaller |
| off | | the actuators apply no force |
| stuck | | they go on with the force of the tick at which the fault began |
| current | x, y, z [m/s, NED], three sigma [m/s], time constant [s] | added to the sea's own, for every vehicle |
| gust | x, y, z [m/s, NED], how long it blows [s] | a current that rises and falls once: (1 - cos) / 2 |
| wrench | five forces and moments [N, N m, body] | added to the disturbance |
| pause | | the agent is suspended: no samples; the vehicle holds its last command |
| slow | ticks | commands take effect so much later |

The last two are handled where a run is stepped (`world.run_state`): they act on simulated time, not on a process.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

WorldFaultKind = Literal[
    "noise", "bias", "freeze", "efficiency", "saturate", "off", "stuck", "current", "wrench",
    "dropout", "gust", "pause", "slow",
]  # fmt: skip


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
        """Whether the fault acts at a tick."""
        return self.begin <= tick and (self.end is None or tick < self.end)

    def concerns(self, i: int) -> bool:
        """Whether the fault acts on vehicle i."""
        return not self.vehicles or i in self.vehicles

    def to_values(self) -> list[Any]:
        """[id, begin, end, kind, vehicles, values]: what travels to the world."""
        return [self.id, self.begin, self.end, self.kind, list(self.vehicles), list(self.values)]

    @classmethod
    def from_values(cls, values: list[Any]) -> WorldFault:
        """The inverse of `to_values`."""
        name, begin, end, kind, vehicles, numbers = values
        return cls(name, begin, end, kind, tuple(vehicles), tuple(float(x) for x in numbers))
