"""A fix by ultra-short baseline: where a modem is, from the sound that comes from it.

| symbol | meaning | unit |
|---|---|---|
| r | slant range, from the travel time of sound | m |
| b | bearing, clockwise from north | rad |
| e | elevation, upwards from the horizontal | rad |
| sigma | standard deviation of the error of b, and of that of e | rad |

east, north, up = r (cos e sin b, cos e cos b, sin e)

The errors of b and e are normal and independent of each other and of the range. That of r has RANGE_SIGMA.
"""

from __future__ import annotations

from math import asin, atan2, cos, hypot, pi, sin
from typing import NamedTuple

from netem.draws import normal

# m: as measured for another maker's system (LinkQuest TrackLink, lslx10.com/html/tl_tank_test.htm: 0.02 m and 0.10 deg
# over 3,000 interrogations in a tank). For EvoLogics that is an assumption.
RANGE_SIGMA = 0.02
_BEARING, _ELEVATION, _RANGE = "usbl bearing", "usbl elevation", "usbl range"  # purposes of draws


class UsblFix(NamedTuple):
    """Where a modem is, as it was measured."""

    range_m: float
    bearing: float  # rad, in [0, 2 pi]
    elevation: float  # rad

    @property
    def enu(self) -> tuple[float, float, float]:
        """East, north and up [m]."""
        flat = self.range_m * cos(self.elevation)
        return flat * sin(self.bearing), flat * cos(self.bearing), self.range_m * sin(self.elevation)


def measure_fix(away: tuple[float, ...], travelled_m: float, sigma: float, seed: int, key: tuple[int, ...]) -> UsblFix:
    """Measure where a sound comes from.

    Args:
        away: north, east and down from here to there [m].
        travelled_m: the way of the sound, from its travel time [m].
        sigma: standard deviation of bearing and elevation [rad].
        seed: of the run.
        key: what makes this measurement another one than any other.

    Returns:
        the fix with its errors.
    """
    north, east, down = away[:3]
    far = hypot(north, east, down)
    bearing, elevation = atan2(east, north), asin(max(-1.0, min(1.0, -down / far))) if far else 0.0
    return UsblFix(
        max(0.0, travelled_m + RANGE_SIGMA * normal(seed, _RANGE, *key)),
        (bearing + sigma * normal(seed, _BEARING, *key)) % (2.0 * pi),
        elevation + sigma * normal(seed, _ELEVATION, *key),
    )
