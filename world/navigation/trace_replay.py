"""The navigation error of a real vehicle, replayed: its agent believes the truth plus the error of the trace."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from netem.wire.messages import Fix, WorldFault
from world.navigation.config import NavigationTrace
from world.navigation.navigator import Believed, State, body
from world.vectors import Vec3


class ReplayedError:
    """The error of one vehicle. It has no filter, and so does not know how sure it is."""

    def __init__(self, config: NavigationTrace, tick_ns: int) -> None:
        self._points = config.points
        self._tick_s = tick_ns / 1e9
        self._tick: int = 0
        self._times = [point.t for point in config.points]

    def error(self, t: float) -> tuple[float, float, float, float, float, float, float]:
        """North, east and down [m], heading [rad], and how fast the first three change [m/s], at a time [s]."""
        points = self._points
        k = bisect_right(self._times, t)
        if k == 0 or k == len(points):
            one = points[0 if k == 0 else -1]
            return one.north, one.east, one.down, one.heading, 0.0, 0.0, 0.0
        a, b = points[k - 1], points[k]
        span = b.t - a.t
        north, east, down = (b.north - a.north) / span, (b.east - a.east) / span, (b.down - a.down) / span
        heading = (b.heading - a.heading) / span
        s = t - a.t
        return (
            a.north + north * s, a.east + east * s, a.down + down * s, a.heading + heading * s, north, east, down,
        )  # fmt: skip

    def belief(self, state: State, roll: tuple[float, ...]) -> Believed:
        """Eta, nu and roll as the vehicle believes them; the arguments are the truth."""
        t = self._tick * self._tick_s
        x, y, z, theta, psi, u, v, w, q, r = state
        north, east, down, heading, by_north, by_east, by_down = self.error(t)
        drift = body((by_north, by_east, by_down), roll[0] if roll else 0.0, theta, psi)
        eta = x + north, y + east, z + down, theta, psi + heading
        return eta, (u + drift[0], v + drift[1], w + drift[2], q, r), roll

    def step(self, before: State, after: State, current: Vec3, faults: Sequence[WorldFault], phi: float) -> None:
        """Move on by a tick."""
        self._tick += 1

    def begin(self, tick: int, state: State) -> None:
        """Go on at a tick, which says it all."""
        self._tick = tick

    def covariance(self) -> tuple[float, ...]:
        return ()

    def take_fixes(self) -> tuple[Fix, ...]:
        return ()
