"""The directed communication graph and its weights.

| symbol | meaning | unit |
|---|---|---|
| a_ij | weight that vehicle i gives to the state received from j; the link (j, i) exists iff a_ij > 0 | 1 |
| b_i | weight that vehicle i gives to its own reference | 1 |
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import dist
from typing import TypeVar

from fleet.scenario.schema.motion import DEFAULT_NEAREST, DEFAULT_PROBABILITY, GraphSection
from netem.condition import Link
from netem.draws import uniform
from world.vectors import Vec3

T = TypeVar("T")
_EDGE = re.compile(r"\s*(\d{1,9})\s*->\s*(\d{1,9})\s*", re.ASCII)


@dataclass(frozen=True)
class Graph:
    """The links in order of (receiver, sender), and the weights b_1, b_2, ..."""

    weights: dict[Link, float]  # (j, i): a_ij
    b: tuple[float, ...]

    @property
    def links(self) -> tuple[Link, ...]:
        return tuple(self.weights)

    def neighbours(self, i: int) -> tuple[tuple[int, float], ...]:
        """The senders that i receives from, in order, with a_ij."""
        return tuple(self._by_receiver.get(i, ()))

    @cached_property
    def _by_receiver(self) -> dict[int, list[tuple[int, float]]]:
        found: dict[int, list[tuple[int, float]]] = {}
        for (src, dst), weight in self.weights.items():
            found.setdefault(dst, []).append((src, weight))
        return found


def neighbours(pairs: Iterable[Link]) -> dict[int, list[int]]:
    """The neighbours of each vehicle that is in a pair."""
    found: dict[int, list[int]] = {}
    for a, b in pairs:
        found.setdefault(a, []).append(b)
        found.setdefault(b, []).append(a)
    return found


def reachable(starts: Iterable[T], hearers: Mapping[T, Iterable[T]]) -> set[T]:
    """The vehicles that what `starts` say can reach, also through others; themselves included.

    `hearers`: who receives from a vehicle; none where it is missing.
    """
    found = set(starts)
    left = list(found)
    while left:
        for j in hearers.get(left.pop(), ()):
            if j not in found:
                found.add(j)
                left.append(j)
    return found


def parse_edge(text: str) -> Link | None:
    """`1->2` is the link (1, 2), from vehicle 1 to vehicle 2; None if the text is no link."""
    match = _EDGE.fullmatch(text)
    return (int(match[1]), int(match[2])) if match else None


def build(section: GraphSection, places: tuple[Vec3, ...], seed: int) -> Graph:
    """The graph of a section that `Parts.graph` accepts.

    `places`: the offsets at the start [m, NED], for `nearest`. `seed`: of the scenario, for `random`.
    """
    vehicles = len(places)
    weights: dict[Link, float] = {}
    weight = 1.0 if section.weight is None else section.weight
    match section.shape:
        case None:
            for text, a in (section.edges or {}).items():
                link = parse_edge(text)
                assert link is not None
                weights[link] = a
        case "path" | "ring":
            weights = _chain(section, vehicles)
        case "star":
            hub = section.hub or 1
            weights = {link: weight for i in range(1, vehicles + 1) if i != hub for link in ((hub, i), (i, hub))}
        case "complete":
            weights = {(j, i): weight for i in range(1, vehicles + 1) for j in range(1, vehicles + 1) if i != j}
        case "nearest":
            for i in range(1, vehicles + 1):
                for j in _nearest(places, i)[: section.count or DEFAULT_NEAREST]:
                    weights[j, i] = weight
        case "random":
            probability = DEFAULT_PROBABILITY if section.probability is None else section.probability
            for i, j in _random_pairs(vehicles, probability, seed):
                weights[i, j] = weights[j, i] = weight
    ordered = {link: weights[link] for link in sorted(weights, key=lambda link: (link[1], link[0]))}
    followers = range(1, vehicles + 1) if section.reference == "all" else section.reference
    return Graph(ordered, tuple(1.0 if i in followers else 0.0 for i in range(1, vehicles + 1)))


def _chain(section: GraphSection, vehicles: int) -> dict[Link, float]:
    weights: dict[Link, float] = {}
    closed = section.shape == "ring"
    for i in range(1, vehicles + 1):
        before = i - 1 if i > 1 else vehicles if closed else None
        behind = i + 1 if i < vehicles else 1 if closed else None
        if before is not None:
            weights[before, i] = 1.0 if section.ahead is None else section.ahead
        if behind is not None:
            weights[behind, i] = 1.0 if section.behind is None else section.behind
    return weights


def _nearest(places: tuple[Vec3, ...], i: int) -> list[int]:
    """The other vehicles, the nearest in the formation first, by number where they are equally far."""
    others = (j for j in range(1, len(places) + 1) if j != i)
    return sorted(others, key=lambda j: (round(dist(places[i - 1], places[j - 1]), 9), j))


def _random_pairs(vehicles: int, probability: float, seed: int) -> list[tuple[int, int]]:
    """A random tree, so that all are connected, and every other pair with the given probability.

    A pair's draw depends on (seed, pair) alone: a larger fleet keeps the pairs of the smaller one.
    """
    pairs = {(1 + int(uniform(seed, "graph tree", i) * (i - 1)), i) for i in range(2, vehicles + 1)}
    for j in range(2, vehicles + 1):
        pairs |= {(i, j) for i in range(1, j) if uniform(seed, "graph", i, j) < probability}
    return sorted(pairs)
