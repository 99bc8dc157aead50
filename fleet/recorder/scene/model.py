"""The scene of a run: what there is to draw, for every renderer.

A renderer is the page, the movie, the scene of Foxglove in the log, or the pictures of the tracks. Each paints the
kinds of `fleet.recorder.scene.primitives` that it has, in its theme. A new thing to draw is a line in
`SceneModel.standing` or `SceneModel.moving`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from math import atan2, cos, hypot, isfinite, pi, sin, sqrt
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from fleet.recorder.scene.primitives import (
    NED,
    REFERENCE,
    AreaShape,
    CircleShape,
    CrossShape,
    CylinderShape,
    FramePoint,
    LineShape,
    Primitive,
    vehicle_frame,
)
from fleet.recorder.scene.styles import (
    ARRIVED,
    COURSE,
    CUT,
    GONE,
    LINK_MEANINGS,
    OBSTACLE,
    PACKET,
    REFERENCE_POINT,
    VEHICLE,
    LinkState,
)
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import OF_LOCALIZATION, OF_NAVIGATION
from world.vectors import Vec3

# --- belief
# The drawing of a vehicle's belief about its place: a cross, and an ellipse that holds the true place with 95 %.
#
# Every vehicle that navigates has the belief of its navigator. A vehicle that uses ranges to others corrects it:
# `by_ranges` puts the corrected belief in its place. All pictures that show a belief use this module.
#
# | symbol | meaning | unit |
# |---|---|---|
# | P = [[a, b], [b, c]] | covariance of north and east | m^2 |
# | l = (a + c) / 2 +- sqrt(((a - c) / 2)^2 + b^2) | its eigenvalues | m^2 |
# | sqrt(5.991 l) | half axes; 5.991 is the 95 % quantile of chi-square with 2 degrees of freedom | m |
# | atan2(2 b, a - c) / 2 | bearing of the long one | rad |


CORNERS = 36  # of an ellipse
_ROUND = [(cos(2.0 * pi * k / CORNERS), sin(2.0 * pi * k / CORNERS)) for k in range(CORNERS)]
_MOST_M = 1e6  # a larger ellipse would be no picture


class PlaceBelief(NamedTuple):
    """A vehicle's belief about its place."""

    off: Vec3  # believed minus true position, NED [m]
    covariance: Sequence[float]  # of north and east: nn, ne, ee [m^2]; empty or NaN: it does not know

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


def drawn_belief(i: int, belief: PlaceBelief) -> list[Primitive]:
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


WATER = 1025.0  # kg/m^3, sea water: a submerged vehicle weighs what it displaces
SLENDER = 7.0  # length over diameter, as of the small torpedo-shaped vehicles
COURSE_POINTS = 400
MANY, CROWD = 12, 24  # vehicles, from which on there is less room for each
WORST = 5  # of a crowd, that have their numbers: those that are farthest off their places
TRAIL_S = 30.0  # that the way of a vehicle is shown
# A packet is drawn slower than it was where the eye could not follow [s of the renderer].
LEAST_FLIGHT_S, MOST_FLIGHT_S = 0.45, 3.0
NO_BELIEFS: Mapping[int, PlaceBelief] = MappingProxyType({})
STOPS = {CUT: 0.3, GONE: 0.55}  # shares of the way at which a packet stops; others arrive


class LegendRow(NamedTuple):
    """The meaning of a sign."""

    sign: str  # `link`, `packet`, or the kind of a primitive
    word: str  # the state of the link, or a colour word
    name: str
    meaning: str


class SceneModel:
    """The drawing of a run, from its scenario alone."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.links = scenario.graph.links
        known = frozenset(self.links)
        self.both_ways = frozenset((src, dst) for src, dst in known if (dst, src) in known)
        self.diameters = [diameter(control.vehicle.m) for control in scenario.controls]  # of the hulls [m]
        self.navigating = [i for i in range(1, scenario.vehicles + 1) if scenario.belief(i)]
        self.changes = bool(self.navigating) or any(plan.changes for plan in scenario.plans)  # whether `moving` does

    def reference(self, t: float) -> Vec3:
        """Where the reference is [m, NED]."""
        return self.scenario.reference.at(t).position

    def offsets(self, t: float) -> list[Vec3]:
        """Where each vehicle should be, from the reference [m, NED]."""
        return [plan.at(t).position for plan in self.scenario.plans]

    def course(self, begin_s: float, end_s: float) -> LineShape:
        times = np.linspace(begin_s, end_s, COURSE_POINTS).tolist()
        return LineShape(COURSE, tuple(FramePoint(NED, *self.reference(t)) for t in times))

    @cached_property
    def obstacles(self) -> list[CylinderShape]:
        apart = self.scenario.spec.keep_apart
        return [CylinderShape(OBSTACLE, *one.at[:2], one.radius) for one in apart.obstacles] if apart else []

    @cached_property
    def standing(self) -> list[Primitive]:
        """The primitives that are painted all the time and stand still."""
        return [*self.obstacles, self.course(0.0, self.scenario.duration_ns / 1e9)]

    def moving(self, t: float, beliefs: Mapping[int, PlaceBelief] = NO_BELIEFS) -> list[Primitive]:
        """The primitives at a time [s] that move with the fleet, without vehicles, links and packets. `beliefs`: the
        positions that the vehicles themselves estimate.
        """
        wanted = [(i, FramePoint(REFERENCE, *offset)) for i, offset in enumerate(self.offsets(t), start=1)]
        return [
            CrossShape(REFERENCE_POINT, FramePoint(REFERENCE), "reference"),
            *(CircleShape(f"vehicle {i}", place, i) for i, place in wanted),
            *(LineShape(f"vehicle {i}", (place, FramePoint(vehicle_frame(i)))) for i, place in wanted),
            *(one for i, belief in sorted(beliefs.items()) for one in drawn_belief(i, belief)),
        ]

    def legend(self) -> list[LegendRow]:
        """The meaning of the signs that occur."""
        rows = [
            LegendRow("link", state.value, state.value, meaning)
            for state, meaning in LINK_MEANINGS.items()
            if state is not LinkState.SILENT
        ]
        if self.scenario.vehicles <= CROWD:
            rows.append(LegendRow("packet", f"{PACKET} {ARRIVED}", "packet", "a packet on its way"))
            rows.append(LegendRow("packet", f"{PACKET} {GONE}", "late or lost", "a packet that is late or gets lost"))
        rows.append(LegendRow("circle", "vehicle 1", "desired place", "where the vehicle should be"))
        rows.append(LegendRow("line", COURSE, "course", "the way of the reference"))
        if self.navigating:
            meaning = "where a vehicle believes it is: a cross, and the ellipse that holds it with 95 %"
            rows.append(LegendRow("area", "vehicle 1", "believed place", meaning))
        if self.obstacles:
            meaning = "a cylinder that vehicles are to keep out of"
            rows.append(LegendRow("cylinder", OBSTACLE, "obstacle", meaning))
        return rows


def diameter(mass: float) -> float:
    """Of a cylinder as slender as ours that displaces `mass` [kg] of sea water [m]."""
    return float((4.0 * mass / (pi * SLENDER * WATER)) ** (1.0 / 3.0))


def depth_text(down: float) -> str:
    """A depth [m] in words. The sea of the model has no surface, so a vehicle that tumbles may rise above 0 m."""
    return f"{down:.1f} m deep" if down > -0.05 else f"{-down:.1f} m above the surface"
