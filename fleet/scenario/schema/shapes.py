"""Named shapes: which keys each takes, and what it is when they are not given."""

from __future__ import annotations

from typing import NamedTuple


class ShapeKeys(NamedTuple):
    """The keys that a shape needs, and further keys that it may have."""

    needed: tuple[str, ...]
    optional: tuple[str, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        return self.needed + self.optional


REFERENCE: dict[str, ShapeKeys] = {
    "line": ShapeKeys(("start", "velocity")),
    "circle": ShapeKeys(("center", "radius", "speed"), ("bearing", "turn")),
    "helix": ShapeKeys(("center", "radius", "speed", "sink"), ("bearing", "turn")),
    "lawn-mower": ShapeKeys(("start", "leg", "legs", "spacing", "speed"), ("heading", "turn")),
    "waypoints": ShapeKeys(("points", "speed", "acceleration"), ("closed",)),
}
FORMATION: dict[str, ShapeKeys] = {
    "offsets": ShapeKeys(("offsets",)),
    "line": ShapeKeys((), ("spacing", "heading")),
    "column": ShapeKeys((), ("spacing", "heading")),
    "wedge": ShapeKeys((), ("spacing", "heading")),
    "circle": ShapeKeys((), ("spacing", "heading")),
    "grid": ShapeKeys((), ("spacing", "heading")),
}
GRAPH: dict[str, ShapeKeys] = {
    "edges": ShapeKeys(("edges",)),
    "path": ShapeKeys((), ("ahead", "behind")),
    "ring": ShapeKeys((), ("ahead", "behind")),
    "star": ShapeKeys((), ("hub", "weight")),
    "complete": ShapeKeys((), ("weight",)),
    "nearest": ShapeKeys((), ("count", "weight")),
    "random": ShapeKeys((), ("probability", "weight")),
}

DEFAULT_SPACING_M = 10.0  # the sides of the paper's square
DEFAULT_NEAREST = 2
DEFAULT_PROBABILITY = 0.2
