"""The drawing of a vehicle's belief about its place: a cross, and an ellipse that holds the true place with 95 %.

Every vehicle that navigates has the belief of its navigator. A vehicle that uses ranges to others corrects it:
`by_ranges` puts the corrected belief in its place. All pictures that show a belief use this module.

| symbol | meaning | unit |
|---|---|---|
| P = [[a, b], [b, c]] | covariance of north and east | m^2 |
| l = (a + c) / 2 +- sqrt(((a - c) / 2)^2 + b^2) | its eigenvalues | m^2 |
| sqrt(5.991 l) | half axes; 5.991 is the 95 % quantile of chi-square with 2 degrees of freedom | m |
| atan2(2 b, a - c) / 2 | bearing of the long one | rad |
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import atan2, cos, hypot, isfinite, pi, sin, sqrt
from typing import NamedTuple

from fleet.recorder.scene.primitives import (
    NED,
    AreaShape,
    CrossShape,
    FramePoint,
    Primitive,
    vehicle_frame,
)
from fleet.recorder.scene.styles import (
    VEHICLE,
)
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import OF_LOCALIZATION, OF_NAVIGATION
from world.vectors import Vec3

CORNERS = 36  # an ellipse is drawn as a polygon
_ROUND = [(cos(2.0 * pi * k / CORNERS), sin(2.0 * pi * k / CORNERS)) for k in range(CORNERS)]
_MOST_M = 1e6  # a larger ellipse would be no picture


class PlaceBelief(NamedTuple):
    """A vehicle's belief about its place."""

    off: Vec3  # believed minus true position, NED [m]
    covariance: Sequence[float]  # north and east: nn, ne, ee [m^2]; empty or NaN: not known

    @classmethod
    def by_navigator(cls, off: Sequence[float], covariance: Sequence[float]) -> PlaceBelief:
        """As the topic `belief` has it. `off`: believed minus true position, NED [m]. `covariance`: of x, y, z and psi:
        upper triangle, row by row; or empty.
        """
        north, east, down = off
        return cls((north, east, down), (*covariance[:2], covariance[4]) if len(covariance) == 10 else ())

    def by_ranges(self, off: Sequence[float], covariance: Sequence[float]) -> PlaceBelief:
        """The belief of a vehicle that uses ranges, as the topic `located` has it. The depth is its navigator's. `off`:
        believed minus true position, north and east [m]. `covariance`: nn, ne, ee [m^2].
        """
        north, east = off
        return PlaceBelief((north, east, self.off[2]), covariance)


class NewestBeliefs:
    """The newest belief of each vehicle, from the messages of a log. An old belief is left out."""

    def __init__(self, scenario: Scenario) -> None:
        # A vehicle with a dead agent has no belief, so an older one is left out.
        self._lasts_s = {
            group: max(1.0, 2.0 * scenario.log_every.get(group, 0) * scenario.tick_ns / 1e9)
            for group in (OF_NAVIGATION, OF_LOCALIZATION)
        }
        self._newest: dict[str, dict[int, tuple[float, Sequence[float], Sequence[float]]]]
        self.clear()

    def clear(self) -> None:
        self._newest = {group: {} for group in self._lasts_s}

    def take(self, i: int, group: str, at_s: float, off: Sequence[float], covariance: Sequence[float]) -> None:
        """Take what the topic `uuv/<i>/belief` or `uuv/<i>/located` has; the group says which."""
        if len(off) == (2 if group == OF_LOCALIZATION else 3):
            self._newest[group][i] = at_s, off, covariance

    def at(self, t: float) -> dict[int, PlaceBelief]:
        """The best that is known of each vehicle's belief at a time [s]."""
        known = {i: PlaceBelief.by_navigator(*belief) for i, belief in self._news(OF_NAVIGATION, t)}
        for i, located in self._news(OF_LOCALIZATION, t):
            if i in known:
                known[i] = known[i].by_ranges(*located)
        return known

    def _news(self, group: str, t: float) -> Iterator[tuple[int, tuple[Sequence[float], Sequence[float]]]]:
        lasts_s = self._lasts_s[group]
        return ((i, (off, cov)) for i, (at_s, off, cov) in self._newest[group].items() if t - at_s <= lasts_s)


def belief_primitives(i: int, belief: PlaceBelief) -> list[Primitive]:
    """The drawing of the belief of vehicle i, next to the vehicle; empty if the belief is not finite."""
    if not all(abs(value) < _MOST_M for value in belief.off):
        return []
    cross = CrossShape(f"{VEHICLE} {i}", FramePoint(vehicle_frame(i), *belief.off), "")
    around = ellipse(i, belief.off, belief.covariance, vehicle_frame(i))
    return [cross] if around is None else [around, cross]


def ellipse(vehicle: int, place: Sequence[float], covariance: Sequence[float], frame: str = NED) -> AreaShape | None:
    """The ellipse of a vehicle; None: it does not know how sure it is, or not at all. `place`: where it believes it is:
    north, east, down [m], in the frame. `covariance`: as in `PlaceBelief`.
    """
    if len(covariance) != 3:
        return None
    a, b, c = covariance
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
