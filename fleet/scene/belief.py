"""The drawing of a vehicle's belief about its place, next to the truth: a cross, and the ellipse that holds it with 95
%.

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
from typing import NamedTuple

from fleet.scene.primitives import NED, AreaShape, CrossShape, FramePoint, Primitive, vehicle_frame
from fleet.scene.styles import VEHICLE
from world.vectors import Vec3

CORNERS = 36  # of an ellipse
_ROUND = [(cos(2.0 * pi * k / CORNERS), sin(2.0 * pi * k / CORNERS)) for k in range(CORNERS)]
_MOST_M = 1e6  # a larger ellipse would be no picture


class PlaceBelief(NamedTuple):
    """A vehicle's belief about its place, as the topic `belief` has it."""

    off: Vec3  # believed minus true position, NED [m]
    covariance: Sequence[float]  # of x, y, z and psi: upper triangle, row by row; empty or NaN: it does not know


def drawn_belief(i: int, belief: PlaceBelief) -> list[Primitive]:
    """The drawing of the belief of vehicle i, next to the vehicle; empty if the belief is not finite."""
    if not all(abs(value) < _MOST_M for value in belief.off):
        return []
    cross = CrossShape(f"{VEHICLE} {i}", FramePoint(vehicle_frame(i), *belief.off), "")
    around = ellipse(i, belief.off, belief.covariance, vehicle_frame(i))
    return [cross] if around is None else [around, cross]


def ellipse(vehicle: int, place: Sequence[float], covariance: Sequence[float], frame: str = NED) -> AreaShape | None:
    """The ellipse of a vehicle; None: it does not know how sure it is, or not at all.

    Args:
        place: where it believes it is: north, east, down [m], in the frame.
        covariance: as in `PlaceBelief`.
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
    ahead_n, ahead_e, aside_n, aside_e = c * long, s * long, -s * short, c * short
    points = tuple(
        FramePoint(frame, north + ahead_n * x + aside_n * y, east + ahead_e * x + aside_e * y, down) for x, y in _ROUND
    )
    return AreaShape(f"{VEHICLE} {vehicle}", points)
