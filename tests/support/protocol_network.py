"""Agents of a protocol without vehicles: they exchange payloads over a network that loses, delays and repeats."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from random import Random
from typing import Any

import pytest
from msgspec import structs

from agents.api import Delivery, Motion, Nav, Vec3

ROUND_TICKS = 10  # of 10 ms
Link = tuple[int, int]


class Still:
    """In place of the agent that keeps the formation: it sends and does nothing."""

    def __init__(self, config: Any) -> None:
        self.signals = ()

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        return ()

    def decide(
        self, nav: Nav, deliveries: Iterable[Delivery], course: Motion | None = None
    ) -> tuple[Vec3, dict[str, float]]:
        return (0.0, 0.0, 0.0), {}


@pytest.fixture
def stand_still(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protocols need no vehicles."""
    for name in ("average", "election", "bundle_auction"):
        monkeypatch.setattr(f"fleet.protocols.{name}.FormationAgent", Still)


def nav(tick: int) -> Nav:
    return Nav(0, tick, (0.0,) * 5, (0.0,) * 5)


def delivery(payload: bytes, src: int = 2, sent: int = 0) -> Delivery:
    return Delivery(sent + 1, sent, src, 0, 0, payload)


class ProtocolNetwork:
    """The agents, what is on its way between them, and what each reported last."""

    def __init__(self, make: Callable[[int], Any], links: Iterable[Link], seed: int = 1) -> None:
        self._make, self._links, self._random = make, tuple(links), Random(seed)
        self.agents: dict[int, Any] = {}
        self.told: dict[int, Mapping[str, Any]] = {}
        self.tick = 0
        self.cut: set[Link] = set()
        self.suspended: set[int] = set()  # nobody asks them, and what they receive waits
        self._waiting: list[tuple[Delivery, int]] = []  # to whom
        for i in sorted({i for link in self._links for i in link}):
            self.start(i)

    def start(self, i: int) -> None:
        """A new life, without memory."""
        self.agents[i] = self._make(i)

    def kill(self, i: int) -> None:
        del self.agents[i]
        self.told.pop(i, None)
        self.suspended.discard(i)

    def split(self, *sides: Iterable[int]) -> None:
        """Cut all links between sides; none: heal."""
        of = {i: k for k, side in enumerate(sides) for i in side}
        self.cut = {(a, b) for a, b in self._links if sides and of[a] != of[b]}

    def run(self, rounds: int, *, loss: float = 0.0, delay: tuple[int, int] = (1, 1), repeat: float = 0.0) -> None:
        """Go on for some rounds; a delay is drawn between two numbers of ticks."""
        for _ in range(rounds):
            self._round(loss, delay, repeat)

    def _round(self, loss: float, delay: tuple[int, int], repeat: float) -> None:
        draw, tick = self._random, self.tick
        later = [each for each in self._waiting if each[0].due_tick > tick or each[1] in self.suspended]
        due = [each for each in self._waiting if each[0].due_tick <= tick and each[1] not in self.suspended]
        due.sort(key=lambda each: structs.astuple(each[0]))
        self._waiting = later
        asked = {i: agent for i, agent in self.agents.items() if i not in self.suspended}
        for i, agent in asked.items():
            _, self.told[i] = agent.decide(nav(tick), [d for d, to in due if to == i])
        sent = {i: agent.transmit(nav(tick)) for i, agent in asked.items()}
        for src, dst in self._links:
            for payload in sent.get(src, ()):
                copies = 0 if (src, dst) in self.cut or draw.random() < loss else 1 + (draw.random() < repeat)
                for copy in range(copies):
                    late = tick + draw.randint(*delay)
                    self._waiting.append((Delivery(late, tick, src, tick, copy, payload), dst))
        self.tick += ROUND_TICKS

    def values(self, signal: str) -> dict[int, Any]:
        return {i: told[signal] for i, told in self.told.items()}


def inside(thing: Any) -> Any:
    """Everything in an object, as plain values that can be compared."""
    if isinstance(thing, Mapping):
        return {key: inside(value) for key, value in thing.items()}
    if isinstance(thing, list | tuple | set):
        return [inside(value) for value in thing]
    return inside(vars(thing)) if hasattr(thing, "__dict__") else thing


def both_ways(*pairs: Link) -> list[Link]:
    return [link for a, b in pairs for link in ((a, b), (b, a))]


def ring(n: int) -> list[Link]:
    return both_ways(*((i, i % n + 1) for i in range(1, n + 1)))


def line(*order: int) -> list[Link]:
    return both_ways(*pairwise(order))
