"""The primitives that a renderer can paint: a few kinds of shape, at points that stand in frames.

A frame moves, and a point moves with it: `ned` stands still, `reference` moves with the reference trajectory, and
`uuv-<i>` with vehicle i. The axes of all of them are north, east, down. Colours are words, which each theme of
`fleet.recorder.scene.styles` makes a colour of.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import msgspec

NED, REFERENCE = "ned", "reference"


def vehicle_frame(i: int) -> str:
    return f"uuv-{i}"


class FramePoint(NamedTuple):
    """A place [m], counted from where its frame is."""

    frame: str
    north: float = 0.0
    east: float = 0.0
    down: float = 0.0


class Primitive(msgspec.Struct, frozen=True, tag_field="kind", tag=lambda name: name.removesuffix("Shape").lower()):
    """Something to paint."""

    colour: str


class CylinderShape(Primitive, frozen=True):
    """A vertical cylinder from the surface to the floor; it stands still."""

    north: float  # place of the axis [m]
    east: float
    radius: float  # m


class CircleShape(Primitive, frozen=True):
    """A place that a vehicle should have, as large on the screen wherever it is."""

    at: FramePoint
    vehicle: int


class CrossShape(Primitive, frozen=True):
    """A place with a name, as large on the screen wherever it is."""

    at: FramePoint
    text: str


class LineShape(Primitive, frozen=True):
    """A thin dashed line through points, which is left out while one of its frames is nowhere."""

    points: tuple[FramePoint, ...]


class AreaShape(Primitive, frozen=True):
    """A flat translucent patch with these corners, which is left out while one of its frames is nowhere."""

    points: tuple[FramePoint, ...]


def plain(things: Iterable[Primitive]) -> list[dict[str, Any]]:
    """Primitives as plain values for JSON, lengths to the millimetre."""

    def rounded(value: Any) -> Any:
        if isinstance(value, list | tuple):
            return [rounded(one) for one in value]
        return round(value, 3) if isinstance(value, float) else value

    return [{key: rounded(value) for key, value in msgspec.to_builtins(thing).items()} for thing in things]


def points_of(primitive: Primitive) -> tuple[FramePoint, ...]:
    """The points of a primitive; none of a cylinder, which has no depth."""
    match primitive:
        case LineShape(points=points) | AreaShape(points=points):
            return points
        case CircleShape(at=at) | CrossShape(at=at):
            return (at,)
        case _:
            return ()
