"""From where a movie shows the fleet."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np

from fleet.logs.records import Array

SCENE_PT = (432.0, 226.0)  # width and height of what is seen of the fleet
MIDDLE_PT = (216.0, 101.0)  # where its middle is: above it stand three lines of text, below it the legend
REACH_PT = 86.0  # from there to the edge of what is to be seen


class Camera:
    """Follows the fleet, and projects places [m, north-east-down] to points of the scene, and their depth of view."""

    def __init__(self, *, above: bool) -> None:
        self.above = above
        self._azimuth, self._elevation = (0.0, pi / 2) if above else (-0.6, 0.5)
        self.centre = np.zeros(3)
        self.radius = 0.0  # of what is to be seen [m]; 0: nothing yet

    def follow(self, points: Array) -> None:
        """Bring points into sight: what is in sight grows and shrinks smoothly, but after a jump."""
        low, high = points.min(axis=0), points.max(axis=0)
        centre, radius = (low + high) / 2, max(2.0, float(np.linalg.norm(high - low)) / 2)
        far = float(np.linalg.norm(centre - self.centre)) > 3 * self.radius
        self.centre = centre
        self.radius = radius if far else self.radius + 0.25 * (radius - self.radius)

    @property
    def scale(self) -> float:
        """Points per m."""
        return REACH_PT / self.radius

    def project(self, places: Any) -> Array:
        """Places (n, 3) as points right, up and away from the eye (n, 3)."""
        north, east, down = (np.asarray(places, float).reshape(-1, 3) - self.centre).T
        ca, sa, ce, se = cos(self._azimuth), sin(self._azimuth), cos(self._elevation), sin(self._elevation)
        away = ca * north - sa * east
        points = np.column_stack([ca * east + sa * north, away * se - down * ce, away * ce + down * se])
        return points * self.scale + (*MIDDLE_PT, 0.0)
