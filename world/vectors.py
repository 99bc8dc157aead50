"""Vectors as tuples of floats: the arithmetic that is done at every tick, without numpy's cost per call.

A numpy array of three numbers costs more than it holds. A batch of all vehicles in numpy wins only with 100 of them, by
0.3 ms of a tick that costs 10 ms, and vehicles that run ahead are integrated one by one anyway.
"""

from __future__ import annotations

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Vec5 = tuple[float, float, float, float, float]
Vec6 = tuple[float, float, float, float, float, float]

ZERO: Vec3 = (0.0, 0.0, 0.0)


def plus(a: Vec3, b: Vec3) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def move_along(a: Vec3, direction: Vec3, length: float) -> Vec3:
    """`a` moved by `length` in a direction."""
    return a[0] + direction[0] * length, a[1] + direction[1] * length, a[2] + direction[2] * length


def scale(a: Vec3, factor: float) -> Vec3:
    return a[0] * factor, a[1] * factor, a[2] * factor


def perpendicular(a: Vec3, ahead: Vec3) -> Vec3:
    """The part of a across a unit vector."""
    return move_along(a, ahead, -dot(a, ahead))


def dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
