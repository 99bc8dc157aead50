"""The section for keeping vehicles apart and out of cylinders: agents.laws.keep_apart."""

from __future__ import annotations

from fleet.scenario.schema.section import Section
from fleet.scenario.schema.value_types import (
    Gain,
    Period,
    PlanPosition,
    PositiveAcceleration,
    PositiveLength,
    PositiveSpeed,
)


class ObstacleSection(Section):
    """A vertical cylinder, from the surface to the bottom."""

    at: PlanPosition  # of its axis: north, east
    radius: PositiveLength


class KeepApartSection(Section):
    """A distance that vehicles keep from each other, and cylinders that they do not enter."""

    distance: PositiveLength
    obstacles: list[ObstacleSection] = []
    gain: Gain = 0.3  # of the barrier: how fast a distance may shrink for each metre that is left
    lag: Period = 1_000_000_000  # the longest time in which a velocity follows its command
    slew: PositiveAcceleration = 0.3  # per axis: how fast the filter changes the command
    acceleration: PositiveAcceleration = 0.5  # what a neighbour may do since it was heard
    speed: PositiveSpeed = 1.5  # likewise; and the limit of what the filter commands on each horizontal axis
    climb: PositiveSpeed = 0.1  # up or down, of any command: a third of the least speed, `tracking.u_floor`
    age_cap: Period = 2_000_000_000  # what is older is extrapolated no further, and its margin grows no more
