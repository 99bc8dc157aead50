"""Who hears whom: the directed communication graph and its weights.

| symbol | meaning | unit |
|---|---|---|
| a_ij | weight that vehicle i gives to what it hears from j; the link (j, i) exists iff a_ij > 0 | 1 |
| b_i | weight that vehicle i gives to its own reference | 1 |
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from fleet.schema import GraphSection
from netem.config import Link

_EDGE = re.compile(r"\s*(\d{1,9})\s*->\s*(\d{1,9})\s*", re.ASCII)


@dataclass(frozen=True, slots=True)
class Graph:
    """The links in order of (receiver, sender), and the weights b_1, b_2, ..."""

    weights: dict[Link, float]  # (j, i): a_ij
    b: tuple[float, ...]

    @property
    def links(self) -> tuple[Link, ...]:
        return tuple(self.weights)

    def neighbours(self, i: int) -> tuple[tuple[int, float], ...]:
        """The vehicles that i hears, in order, with a_ij."""
        return tuple((src, weight) for (src, dst), weight in self.weights.items() if dst == i)


def parse_edge(text: str) -> Link | None:
    """`1->2` is the link (1, 2), by which vehicle 2 hears vehicle 1; None if the text is no link."""
    match = _EDGE.fullmatch(text)
    return (int(match[1]), int(match[2])) if match else None


def build(section: GraphSection, vehicles: int) -> Graph:
    """The graph of a valid section (`fleet.rules` has looked at it)."""
    weights: dict[Link, float] = {}
    if section.edges is not None:
        for text, weight in section.edges.items():
            link = parse_edge(text)
            assert link is not None
            weights[link] = weight
    else:
        closed = section.shape == "ring"
        for i in range(1, vehicles + 1):
            before = i - 1 if i > 1 else vehicles if closed else None
            behind = i + 1 if i < vehicles else 1 if closed else None
            if before is not None:
                weights[before, i] = 1.0 if section.ahead is None else section.ahead
            if behind is not None:
                weights[behind, i] = 1.0 if section.behind is None else section.behind
    ordered = {link: weights[link] for link in sorted(weights, key=lambda link: (link[1], link[0]))}
    followers = range(1, vehicles + 1) if section.reference == "all" else section.reference
    return Graph(ordered, tuple(1.0 if i in followers else 0.0 for i in range(1, vehicles + 1)))
