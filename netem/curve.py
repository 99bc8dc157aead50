"""A quantity that was measured at some points, and is a straight line between them."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Curve:
    """Points (x, y), x ascending: y is linear between two points, and constant before the first and after the last."""

    points: tuple[tuple[float, float], ...]

    def at(self, x: float) -> float:
        points = self.points
        after = bisect_left(points, x, key=lambda point: point[0])
        if after == 0:
            return points[0][1]
        if after == len(points):
            return points[-1][1]
        (x0, y0), (x1, y1) = points[after - 1], points[after]
        return y0 + (y1 - y0) * (x - x0) / (x1 - x0)
