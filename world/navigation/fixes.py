"""Fixes of the horizontal position: by GPS near the surface, by USBL or LBL within reach of the beacons.

A fix is measured at one tick and used some ticks later, as a measurement of where the vehicle was then.

The noise on each axis is sqrt(noise^2 + (growth * distance)^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

from netem.draws import normal, uniform
from netem.fault_kinds import WorldFaultKind
from netem.wire.messages import Fix, WorldFault
from world.navigation.config import FixSource, jumps, lost
from world.navigation.filter import NavigationFilter
from world.navigation.instruments import PURPOSE, due
from world.vectors import Vec3

MOST_SOURCES = 8
NOISE, LOSS = f"{PURPOSE} fix", f"{PURPOSE} fix loss"


class Fixes:
    """The fixes of one vehicle: those under way."""

    def __init__(self, sources: tuple[FixSource, ...], seed: int, i: int, tick_ns: int) -> None:
        self._sources, self._seed, self._i, self._tick_ns = sources, seed, i, tick_ns
        # Due tick, tick at which it was measured, number of the source, north, east [m], sigma [m].
        self._under_way: list[list[float]] = []

    def measure(self, tick: int, true: Vec3, estimate: NavigationFilter, faults: Sequence[WorldFault]) -> None:
        """Measure what is due at a tick. `true`: position [m, NED]. `estimate`: of the position at this tick."""
        seed, i = self._seed, self._i
        for number, source in enumerate(self._sources):
            if not due(tick, self._tick_ns, source.period_ns):
                continue
            sigma = _sigma(source, true)
            if sigma < 0.0 or (source.loss > 0.0 and uniform(seed, LOSS, i, tick, number) < source.loss):
                continue
            gone = False
            off = [sigma * normal(seed, NOISE, i, tick, number, axis) for axis in range(2)]
            for fault in faults:
                if fault.kind == WorldFaultKind.FIX:
                    gone = gone or lost(fault, seed, i, tick, number)
                    jump = jumps(fault, seed, i, tick, 2, number)
                    off = [off[axis] + fault.values[1 + axis] + jump[axis] for axis in range(2)]
            if gone:
                continue
            estimate.keep_position(self._key(tick, number))
            later = tick + -(-source.delay_ns // self._tick_ns)
            self._under_way.append([later, tick, number, true[0] + off[0], true[1] + off[1], sigma])

    def use(self, tick: int, estimate: NavigationFilter) -> list[Fix]:
        """Let the filter have what is due; returns these fixes."""
        found: list[Fix] = []
        ready = [one for one in self._under_way if one[0] <= tick]
        if not ready:
            return found
        self._under_way = [one for one in self._under_way if one[0] > tick]
        for _, then, source, north, east, sigma in ready:
            measured, number = int(then), int(source)
            nis, used = estimate.position(self._key(measured, number), north, east, sigma)
            found.append(Fix(self._sources[number].kind, measured, tick, (north, east), sigma, nis, used))
        return found

    @staticmethod
    def _key(tick: int, number: int) -> int:
        return tick * MOST_SOURCES + number


def _sigma(source: FixSource, true: Vec3) -> float:
    """The standard deviation of a fix on each axis [m]; negative: there is none."""
    if source.kind == "gps":
        return source.noise if true[2] <= source.depth else -1.0
    x, y, z = source.at
    distance = hypot(true[0] - x, true[1] - y, true[2] - z)
    if source.reach and distance > source.reach:
        return -1.0
    return hypot(source.noise, source.growth * distance)
