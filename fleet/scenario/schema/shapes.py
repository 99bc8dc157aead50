"""Named shapes: which keys each takes, and what it is when they are not given."""

from __future__ import annotations

from typing import NamedTuple


class Keys(NamedTuple):
    """The keys that a shape needs, and those that it may have."""

    needed: tuple[str, ...]
    optional: tuple[str, ...] = ()

    @property
    def all(self) -> tuple[str, ...]:
        return self.needed + self.optional


REFERENCE: dict[str, Keys] = {
    "line": Keys(("start", "velocity")),
    "circle": Keys(("center", "radius", "speed"), ("bearing", "turn")),
    "helix": Keys(("center", "radius", "speed", "sink"), ("bearing", "turn")),
    "lawn-mower": Keys(("start", "leg", "legs", "spacing", "speed"), ("heading", "turn")),
    "waypoints": Keys(("points", "speed", "acceleration"), ("closed",)),
}
FORMATION: dict[str, Keys] = {
    "offsets": Keys(("offsets",)),
    "line": Keys((), ("spacing", "heading")),
    "column": Keys((), ("spacing", "heading")),
    "wedge": Keys((), ("spacing", "heading")),
    "circle": Keys((), ("spacing", "heading")),
    "grid": Keys((), ("spacing", "heading")),
}
GRAPH: dict[str, Keys] = {
    "edges": Keys(("edges",)),
    "path": Keys((), ("ahead", "behind")),
    "ring": Keys((), ("ahead", "behind")),
    "star": Keys((), ("hub", "weight")),
    "complete": Keys((), ("weight",)),
    "nearest": Keys((), ("count", "weight")),
    "random": Keys((), ("probability", "weight")),
}

DEFAULT_SPACING_M = 10.0  # the sides of the paper's square
DEFAULT_NEAREST = 2
DEFAULT_PROBABILITY = 0.2
