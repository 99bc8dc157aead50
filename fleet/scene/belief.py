"""How sure a vehicle is of its place: the ellipse that holds it with 95 %, from the covariance of its estimate.

| symbol | meaning | unit |
|---|---|---|
| P = [[a, b], [b, c]] | covariance of north and east | m^2 |
| l = (a + c) / 2 +- sqrt(((a - c) / 2)^2 + b^2) | its eigenvalues | m^2 |
| sqrt(5.991 l) | half axes; 5.991 is the 95 % quantile of chi-square with 2 degrees of freedom | m |
| atan2(2 b, a - c) / 2 | bearing of the long one | rad |
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, hypot, isfinite, pi, sin, sqrt

from fleet.scene.primitives import NED, FramePoint, LineShape
from fleet.scene.styles import VEHICLE

_TURNS = [2.0 * pi * k / 48 for k in range(49)]
_MOST_M = 1e6  # a larger ellipse would be no picture


def ellipse(vehicle: int, place: Sequence[float], covariance: Sequence[float]) -> LineShape | None:
    """The ellipse of a vehicle as a line round it; None: it does not know how sure it is, or not at all.

    Args:
        place: where it believes it is: north, east, down [m].
        covariance: of x, y, z and psi, as the topic `belief` has it: upper triangle, row by row.
    """
    if len(covariance) != 10:
        return None
    a, b, c = covariance[0], covariance[1], covariance[4]
    middle, radius = (a + c) / 2.0, hypot((a - c) / 2.0, b)
    if not all(map(isfinite, (middle, radius, *place))) or middle < radius * (1.0 - 1e-9):
        return None
    long, short = sqrt(5.991 * (middle + radius)), sqrt(5.991 * max(0.0, middle - radius))
    bearing = atan2(2.0 * b, a - c) / 2.0
    if long > _MOST_M:
        return None
    north, east, down = place
    c, s = cos(bearing), sin(bearing)
    around = [(long * cos(turn), short * sin(turn)) for turn in _TURNS]
    points = tuple(FramePoint(NED, north + c * x - s * y, east + s * x + c * y, down) for x, y in around)
    return LineShape(f"{VEHICLE} {vehicle}", points)
