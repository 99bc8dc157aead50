"""Where the fleet should be: the reference trajectory as a line, a circle or a path of legs and arcs.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| eta_1^d(t) | reference trajectory, known to every vehicle | m | NED | (11) |
| v_d(t) | its velocity | m/s | NED | (11) |
| p_i(t) | offset of vehicle i in the formation: eta_i^d = eta_1^d + p_i | m | NED | (8) |
| s | length along a path | m | - | |

Assumption 2 of the paper wants the reference and its first two derivatives bounded. So a path turns on arcs, never
at a corner, and a formation changes along a blend whose velocity and acceleration are continuous.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, hypot, pi, sin, tan
from typing import Any, Literal, NamedTuple

from agents.errors import AgentError
from world.vectors import ZERO, Vec3, dot, minus, move_along, perpendicular, scale

# Directions closer than this [rad] need no arc between them.
STRAIGHT = 1e-9


class Motion(NamedTuple):
    """Where to be, and how to move."""

    position: Vec3  # m, NED
    velocity: Vec3  # m/s over ground, NED


@dataclass(frozen=True, slots=True)
class StraightLine:
    """start + velocity t: the paper's reference."""

    start: Vec3
    velocity: Vec3
    kind: Literal["line"] = "line"

    def at(self, t: float) -> Motion:
        """Position and velocity at time t [s]."""
        x, y, z = self.start
        vx, vy, vz = self.velocity
        return Motion((x + vx * t, y + vy * t, z + vz * t), self.velocity)

    def displacement(self, begin: float, span: float) -> Vec3:
        """How far the reference moves [m, NED] in `span` from time `begin` [s]."""
        vx, vy, vz = self.velocity
        return vx * span, vy * span, vz * span

    @property
    def acceleration(self) -> float:
        """The largest acceleration [m/s^2]."""
        return 0.0

    def velocity_bounds(self) -> tuple[Vec3, Vec3]:
        """Smallest and largest velocity on each axis [m/s, NED]."""
        return self.velocity, self.velocity


@dataclass(frozen=True, slots=True)
class Circle:
    """A horizontal circle at constant speed, and a helix when it sinks or rises meanwhile."""

    center: Vec3  # m, NED; z at t = 0
    radius: float  # m
    speed: float  # m/s, along the circle
    bearing: float  # rad, of the starting point as seen from the centre, clockwise from north
    sense: float  # 1 clockwise seen from above (to starboard), -1 anticlockwise
    sink: float = 0.0  # m/s, downwards
    kind: Literal["circle"] = "circle"

    def at(self, t: float) -> Motion:
        """Position and velocity at time t [s]."""
        cx, cy, cz = self.center
        angle = self.bearing + self.sense * self.speed / self.radius * t
        c, s = cos(angle), sin(angle)
        along = self.sense * self.speed
        return Motion(
            (cx + self.radius * c, cy + self.radius * s, cz + self.sink * t), (-along * s, along * c, self.sink)
        )

    def displacement(self, begin: float, span: float) -> Vec3:
        """How far the reference moves [m, NED] in `span` from time `begin` [s]."""
        return minus(self.at(begin + span).position, self.at(begin).position)

    @property
    def acceleration(self) -> float:
        """The largest acceleration [m/s^2]."""
        return self.speed * self.speed / self.radius

    def velocity_bounds(self) -> tuple[Vec3, Vec3]:
        """Smallest and largest velocity on each axis [m/s, NED]."""
        v = self.speed
        return (-v, -v, self.sink), (v, v, self.sink)


class PathError(AgentError):
    """Points that no path with these arcs goes through; `leg` counts from 1, 0 when it is about all of them."""

    def __init__(self, leg: int, message: str) -> None:
        super().__init__(message)
        self.leg = leg


class _Piece(NamedTuple):
    """A straight piece (radius 0) or an arc of a path: point(s) from where it starts, and two unit vectors."""

    origin: Vec3  # start of a straight piece, centre of an arc
    radius: float
    ahead: Vec3  # direction at the piece's start
    inward: Vec3  # from the start of an arc towards its centre


@dataclass(frozen=True)
class Path:
    """Straight legs between points, rounded by arcs of one radius, at constant speed.

    An open path goes on straight after its last point: a vehicle that cannot hover needs somewhere to go. A closed
    one leads from the last point back to the first, again and again, and begins where the first corner's arc ends.
    """

    points: tuple[Vec3, ...]  # m, NED
    speed: float  # m/s
    radius: float  # m, of the arcs
    closed: bool = False
    kind: Literal["path"] = "path"

    def at(self, t: float) -> Motion:
        """Position and velocity at time t [s]."""
        starts, pieces, length = self._pieces
        s = self.speed * t
        if self.closed:
            s %= length
        index = bisect_right(starts, s) - 1 if s > 0.0 else 0
        piece, along = pieces[index], s - starts[index]
        ahead = piece.ahead
        if piece.radius == 0.0:
            return Motion(move_along(piece.origin, ahead, along), scale(ahead, self.speed))
        angle = along / piece.radius
        c, sn = cos(angle), sin(angle)
        position = move_along(move_along(piece.origin, piece.inward, -piece.radius * c), ahead, piece.radius * sn)
        return Motion(position, scale(move_along(scale(ahead, c), piece.inward, sn), self.speed))

    def displacement(self, begin: float, span: float) -> Vec3:
        """How far the reference moves [m, NED] in `span` from time `begin` [s]."""
        return minus(self.at(begin + span).position, self.at(begin).position)

    @property
    def acceleration(self) -> float:
        """The largest acceleration [m/s^2]."""
        return self.speed * self.speed / self.radius if any(p.radius for p in self._pieces[1]) else 0.0

    @property
    def length(self) -> float:
        """Length of the path [m]: all the way round a closed one, to the last point of an open one."""
        return self._pieces[2]

    def velocity_bounds(self) -> tuple[Vec3, Vec3]:
        """Smallest and largest velocity on each axis [m/s, NED]; sampled along the arcs, to a degree."""
        starts, pieces, length = self._pieces
        low, high = list(scale(pieces[0].ahead, self.speed)), list(scale(pieces[0].ahead, self.speed))
        for start, end, piece in zip(starts, [*starts[1:], length], pieces, strict=True):
            steps = max(1, round((end - start) / piece.radius * 180.0 / pi)) if piece.radius else 1
            for step in range(steps + 1):
                velocity = self.at((start + (end - start) * step / steps) / self.speed).velocity
                low = [min(a, b) for a, b in zip(low, velocity, strict=True)]
                high = [max(a, b) for a, b in zip(high, velocity, strict=True)]
        return (low[0], low[1], low[2]), (high[0], high[1], high[2])

    @cached_property
    def _pieces(self) -> tuple[list[float], list[_Piece], float]:
        points = self.points
        count = len(points)
        if count < (3 if self.closed else 2):
            raise PathError(0, f"needs {3 if self.closed else 2} points or more, got {count}")
        legs = [(points[n], points[(n + 1) % count]) for n in range(count if self.closed else count - 1)]
        directions: list[Vec3] = []
        lengths: list[float] = []
        for number, (a, b) in enumerate(legs, start=1):
            step = minus(b, a)
            length = hypot(*step)
            if length < 1e-6:
                raise PathError(number, "two consecutive points are the same")
            directions.append(scale(step, 1.0 / length))
            lengths.append(length)
        # How much of each leg the arc at its end takes from it, and from the next one.
        tangents = [0.0] * len(legs)
        turns = [0.0] * len(legs)
        for n in range(len(legs) if self.closed else len(legs) - 1):
            ahead, following = directions[n], directions[(n + 1) % len(legs)]
            # Not acos, which takes a rounding error of 1e-16 in the cosine for a turn of 1e-8.
            turn = atan2(hypot(*perpendicular(following, ahead)), dot(following, ahead))
            if turn > pi - 1e-3:
                raise PathError(n + 1, "turns back on itself, which no arc can follow: put a point beside it")
            if turn > STRAIGHT:
                turns[n], tangents[n] = turn, self.radius * tan(turn / 2)
        starts: list[float] = []
        pieces: list[_Piece] = []
        s = 0.0
        for n, (a, _) in enumerate(legs):
            before = tangents[n - 1] if n or self.closed else 0.0
            straight = lengths[n] - before - tangents[n]
            if straight < -1e-9:
                raise PathError(
                    n + 1,
                    f"is {lengths[n]:g} m long, but the arcs at its ends, of radius {self.radius:g} m, take "
                    f"{before + tangents[n]:.4g} m of it",
                )
            ahead = directions[n]
            starts.append(s)
            pieces.append(_Piece(move_along(a, ahead, before), 0.0, ahead, ZERO))
            s += max(0.0, straight)
            if turns[n]:
                following = directions[(n + 1) % len(legs)]
                across = perpendicular(following, ahead)
                inward = scale(across, 1.0 / hypot(*across))
                entry = move_along(a, ahead, lengths[n] - tangents[n])
                starts.append(s)
                pieces.append(_Piece(move_along(entry, inward, self.radius), self.radius, ahead, inward))
                s += self.radius * turns[n]
        return starts, pieces, s


Reference = StraightLine | Circle | Path

_REFERENCES: dict[str, type[StraightLine] | type[Circle] | type[Path]] = {
    "line": StraightLine,
    "circle": Circle,
    "path": Path,
}


def reference_type(values: dict[str, Any] | None) -> type[StraightLine] | type[Circle] | type[Path] | None:
    """The class of a reference that travels as plain values, by its `kind`; None of none. Raises ValueError if there is
    no such kind.
    """
    if values is None:
        return None
    if (kind := values.get("kind")) not in _REFERENCES:
        raise ValueError(f"no reference is of kind {kind!r:.40}; there are {', '.join(_REFERENCES)}")
    return _REFERENCES[kind]
