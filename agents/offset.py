"""The desired place of a vehicle in the formation, and its changes over time."""

from __future__ import annotations

from dataclasses import dataclass, field

from agents.trajectory import Motion
from world.vectors import ZERO, Vec3, minus, move_along, scale


@dataclass(frozen=True, slots=True)
class OffsetChange:
    """From `begin` [s] on the offset moves to `offset` [m, NED], where it arrives `blend` [s] later."""

    begin: float
    blend: float
    offset: Vec3


@dataclass(frozen=True, slots=True)
class Offset:
    """An offset that may change: p_i(t), or Delta_ij(t) = p_i(t) - p_j(t)."""

    start: Vec3  # m, NED
    # In order of time; no change begins before the one before is complete.
    changes: tuple[OffsetChange, ...] = field(default=())

    def at(self, t: float) -> Motion:
        """The offset [m, NED] and its rate [m/s] at time t [s].

        A blend follows 10 x^3 - 15 x^4 + 6 x^5: at rest at both ends, with a continuous acceleration, and at most
        1.875 times as fast as a straight change.
        """
        offset = self.start
        for change in self.changes:
            if t >= change.begin + change.blend:
                offset = change.offset
            elif t > change.begin:
                x = (t - change.begin) / change.blend
                way = x * x * x * (10.0 + x * (6.0 * x - 15.0))
                rate = 30.0 * x * x * (1.0 - x) * (1.0 - x) / change.blend
                step = minus(change.offset, offset)
                return Motion(move_along(offset, step, way), scale(step, rate))
            else:
                break
        return Motion(offset, ZERO)

    @property
    def moving(self) -> bool:
        return bool(self.changes)
