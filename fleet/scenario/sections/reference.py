"""The reference trajectory of a scenario, built from the keys of its shape."""

from __future__ import annotations

from math import cos, sin

from agents.trajectory import Circle, Path, Reference, StraightLine
from fleet.scenario.schema.motion import (
    ReferenceSection,
)
from world.vectors import Vec3


def build(section: ReferenceSection) -> Reference:
    """The trajectory of a section that has the keys of its shape.

    A path is not walked here: `Path.length` raises PathError if its arcs do not fit.
    """
    s = section
    match s.shape:
        case None | "line":
            assert s.start is not None and s.velocity is not None
            return StraightLine(s.start, s.velocity)
        case "circle" | "helix":
            assert s.center is not None and s.radius is not None and s.speed is not None
            sense = -1.0 if s.turn == "port" else 1.0
            return Circle(s.center, s.radius, s.speed, s.bearing or 0.0, sense, s.sink or 0.0)
        case "lawn-mower":
            assert s.start is not None and s.spacing is not None and s.speed is not None
            return Path(_lawn(s), s.speed, s.spacing / 2.0)
        case "waypoints":
            assert s.points is not None and s.speed is not None and s.acceleration is not None
            return Path(tuple(s.points), s.speed, s.speed * s.speed / s.acceleration, bool(s.closed))


def _lawn(s: ReferenceSection) -> tuple[Vec3, ...]:
    """The corners of parallel legs, each joined to the next by a half circle."""
    assert s.start is not None and s.leg is not None and s.legs is not None and s.spacing is not None
    heading = s.heading or 0.0
    side = -1.0 if s.turn == "port" else 1.0
    x, y, z = s.start
    c, sn = cos(heading), sin(heading)
    corners: list[Vec3] = []
    for leg in range(s.legs):
        across = side * leg * s.spacing
        ends = (0.0, s.leg) if leg % 2 == 0 else (s.leg, 0.0)
        corners += [(x + c * along - sn * across, y + sn * along + c * across, z) for along in ends]
    return tuple(corners)
