"""Which modem of an acoustic channel has transmitted when, as far as the packets of a page tell it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import dist, isfinite
from typing import Any

from fleet.logs.transmissions import UNSENT, begin_of, end_of, name_of
from netem.condition import Link
from netem.modem import AcousticConfig
from netem.modem_frame import size_on_air
from world.vectors import Vec3

MOST = 2000  # transmissions that a page keeps, and packets that count as known
Transmission = tuple[int, float, float]  # sender, begin, airtime [s]


class OnAir:
    """The transmissions of the last minute. They are known when the first packet has arrived or is lost. Places of that
    moment count, not those of the beginning: at 2 m/s and 2 s that is 3 ms."""

    def __init__(self, acoustic: AcousticConfig, tick_s: float) -> None:
        self._acoustic, self._tick_s = acoustic, tick_s
        self.clear()

    def clear(self) -> None:
        self.all: deque[Transmission] = deque(maxlen=MOST)
        self.fresh: deque[Transmission] = deque(maxlen=MOST)  # since the last frame
        self._known: dict[tuple[int, ...], None] = {}

    def packet(self, link: Link, message: Any, places: Mapping[int, Vec3]) -> None:
        """Take a message of a topic `link/<src>-<dst>`."""
        src, dst = link
        name = name_of(link, message.seq, self._acoustic)
        times = message.sent, message.due, message.delay
        if message.copy or message.fate in UNSENT or name in self._known or not all(map(isfinite, times)):
            return
        self._known[name] = None
        if len(self._known) > MOST:
            del self._known[next(iter(self._known))]
        away = dist(places[src], places[dst]) if src in places and dst in places else 0.0
        size = getattr(message, "size", 0) or size_on_air(message.payload)
        airtime = self._acoustic.modem_of(src).airtime_ns(size) / 1e9
        end = end_of(*times, message.fate)
        flight = away / self._acoustic.sound_speed
        begin = begin_of(link, airtime, end, message.fate, lambda _: flight, self._acoustic, self._tick_s)
        one = src, round(begin, 4), round(airtime, 4)
        self.all.append(one)
        self.fresh.append(one)
