"""The scene of a run: what there is to draw, for every renderer.

A renderer is the page, the movie, the scene of Foxglove in the log, or the pictures of the tracks. Each paints the
kinds of `fleet.recorder.scene.primitives` that it has, in its theme. A new thing to draw is a line in
`SceneModel.standing` or `SceneModel.moving`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from math import pi
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from fleet.recorder.scene.belief import PlaceBelief, belief_primitives
from fleet.recorder.scene.link_state import ARRIVED, CUT, GONE, LinkState
from fleet.recorder.scene.primitives import (
    NED,
    REFERENCE,
    CircleShape,
    CrossShape,
    CylinderShape,
    FramePoint,
    LineShape,
    Primitive,
    vehicle_frame,
)
from fleet.recorder.scene.styles import COURSE, LINK_MEANINGS, OBSTACLE, PACKET, REFERENCE_POINT
from fleet.scenario.scenario import Scenario
from world.vectors import Vec3

WATER = 1025.0  # kg/m^3, sea water: a submerged vehicle weighs what it displaces
SLENDER = 7.0  # length over diameter, as of the small torpedo-shaped vehicles
COURSE_POINTS = 400
MANY, CROWD = 12, 24  # vehicles, from which on there is less room for each
WORST = 5  # in a crowd only the vehicles farthest off their places have their numbers
TRAIL_S = 30.0  # length of the way that is shown of a vehicle
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
        self.diameters = [diameter(control.vehicle.m) for control in scenario.controls]  # diameters of the hulls [m]
        self.guided = not scenario.spec.moored and not scenario.nodes  # whether vehicles of ours have places to keep
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
        course = [self.course(0.0, self.scenario.duration_ns / 1e9)] if self.guided else []
        return [*self.obstacles, *course]

    def moving(self, t: float, beliefs: Mapping[int, PlaceBelief] = NO_BELIEFS) -> list[Primitive]:
        """The primitives at a time [s] that move with the fleet, without vehicles, links and packets. `beliefs`: the
        positions that the vehicles themselves estimate.
        """
        offsets = enumerate(self.offsets(t), start=1) if self.guided else ()
        wanted = [(i, FramePoint(REFERENCE, *offset)) for i, offset in offsets]
        return [
            *([CrossShape(REFERENCE_POINT, FramePoint(REFERENCE), "reference")] if self.guided else []),
            *(CircleShape(f"vehicle {i}", place, i) for i, place in wanted),
            *(LineShape(f"vehicle {i}", (place, FramePoint(vehicle_frame(i)))) for i, place in wanted),
            *(one for i, belief in sorted(beliefs.items()) for one in belief_primitives(i, belief)),
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
        if self.guided:
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
