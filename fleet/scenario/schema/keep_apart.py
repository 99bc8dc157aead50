"""What a scenario says of keeping vehicles apart and out of cylinders; `agents.laws.keep_apart` does it."""

from __future__ import annotations

from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section


class ObstacleSection(Section):
    """A vertical cylinder, from the surface to the bottom."""

    at: v.PlanPosition  # place of the axis: north, east
    radius: v.PositiveLength


class KeepApartSection(Section):
    """A distance that vehicles keep from each other, and cylinders that they do not enter."""

    distance: v.PositiveLength
    obstacles: list[ObstacleSection] = []
    gain: v.Gain = 0.3  # how fast a distance may shrink for each metre that is left
    lag: v.Period = 1_000_000_000  # the longest time in which a velocity follows its command
    slew: v.PositiveAcceleration = 0.3  # per axis: how fast the filter changes the command
    acceleration: v.PositiveAcceleration = 0.5  # the most that a neighbour accelerates after it was heard
    speed: v.PositiveSpeed = 1.5  # the most that a neighbour, and a command on each horizontal axis, may have
    climb: v.PositiveSpeed = 0.1  # up or down, of any command: a third of the least speed, `tracking.u_floor`
    age_cap: v.Period = 2_000_000_000  # what is older is extrapolated no further, and its margin grows no more
