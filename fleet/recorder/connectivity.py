"""Whether what was delivered within a window connects every vehicle with the reference, window after window.

The graph of a window of W ticks that ends with tick t has a link (j, i) if it delivered a whole payload at a tick in (t
- W, t]. The window is connected if a path over its links leads to every vehicle from one that follows the reference
(b_i > 0). In other words, with the reference as the root, the union of the graphs within the window contains a spanning
tree. That it does so in every window of some length is what consensus needs in a changing topology (A. Jadbabaie, J.
Lin, A. S. Morse, IEEE TAC 48(6), 2003, "jointly connected", with a leader; W. Ren, R. W. Beard, IEEE TAC 50(5), 2005,
"the union has a spanning tree frequently enough"); their proofs are for links without delay.

Windows slide by single ticks, exactly: a link goes when its last delivery leaves the window, and only then can anything
become unreached.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from copy import copy
from typing import NamedTuple

from fleet.quantities import vehicle_numbers
from fleet.scenario.scenario import Scenario
from netem.cause import Cause
from netem.condition import Link
from netem.wire.messages import Fate


class Outage(NamedTuple):
    """Windows that end at ticks from `begin` to below `end`, with the vehicles not reached in the first of them."""

    begin: int
    end: int
    unreached: tuple[int, ...]


class Connectivity:
    """Follows the windows of one length through the fates of a run, in the order of the journal."""

    def __init__(
        self, links: Iterable[Link], roots: Iterable[int], wanted: Iterable[int], window: int, after: int = 0
    ) -> None:
        """`roots` follow the reference, `wanted` must be reached. `window` is W, in ticks; the first one begins at
        `after`.
        """
        self._hearers: dict[int, list[int]] = {}
        for src, dst in links:
            self._hearers.setdefault(src, []).append(dst)
        self._roots, self._wanted = tuple(roots), tuple(wanted)
        self._window, self._first = window, after + window - 1
        self._last: dict[Link, int] = {}  # tick of the last delivery, of the links that the window has
        self._order: deque[tuple[int, Link]] = deque()  # (tick, link) of deliveries within the window
        self._now = 0  # tick whose fates are coming in
        self._changed = True  # since the last look
        self._outage: Outage | None = None  # the outage that goes on
        self.first: Outage | None = None
        self.outages = 0
        self.ticks = 0  # windows that were not connected
        self.windows = 0

    def begin(self, tick: int) -> None:
        """Count windows that begin at this tick or later."""
        self._first = max(self._first, tick + self._window - 1)

    @property
    def trivial(self) -> bool:
        """Whether no vehicle needs to be reached."""
        return set(self._wanted) <= set(self._roots)

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> Connectivity | None:
        """The input that the scenario's check needs; None if it has no such check."""
        check = scenario.spec.checks.connected
        if check is None:
            return None
        everyone = range(1, scenario.vehicles + 1)
        roots = [i for i in everyone if scenario.b[i - 1] > 0.0]
        wanted = vehicle_numbers(check.vehicles) if check.vehicles else everyone
        tick = scenario.tick_ns
        return cls(scenario.graph.links, roots, wanted, check.window // tick, -(-check.after // tick))

    def settle(self, fate: Fate) -> None:
        if fate.cause != Cause.DELIVERED or fate.corrupted:
            return
        if fate.due_tick > self._now:
            self._go_to(fate.due_tick)
        link = (fate.src, fate.dst)
        before = self._last.get(link)
        if before == fate.due_tick:
            return
        self._changed |= before is None
        self._last[link] = fate.due_tick
        self._order.append((fate.due_tick, link))

    def close(self, end: int) -> None:
        """Judge the windows that end before tick `end`; nothing comes after that."""
        if end > self._now:
            self._go_to(end)
        if self._outage is not None:
            self._ended(end)
        self.windows = max(0, end - self._first)

    def so_far(self, end: int) -> Connectivity:
        """The result that `close` would return now; this object goes on."""
        found = copy(self)
        found._last, found._order = dict(self._last), deque(self._order)
        found.close(end)
        return found

    def _go_to(self, tick: int) -> None:
        """Judge the windows that end before `tick`, and drop everything older than the window that ends with it."""
        if self._now < self._first < tick:
            self._go_to(self._first)
        self._look()
        while self._order and self._order[0][0] + self._window <= tick:
            delivered, link = self._order.popleft()
            if self._last[link] != delivered:
                continue
            gone = delivered + self._window
            if gone > self._now:
                self._look()  # all that goes at the tick before is gone
                self._now = gone
            del self._last[link]
            self._changed = True
        if tick > self._now:
            self._look()
            self._now = tick

    def _look(self) -> None:
        if not self._changed or self._now < self._first:
            return
        self._changed = False
        unreached = self._unreached()
        if self._outage is not None and not unreached:
            self._ended(self._now)
        elif self._outage is None and unreached:
            self._outage = Outage(self._now, self._now, unreached)

    def _ended(self, tick: int) -> None:
        assert self._outage is not None
        outage, self._outage = self._outage._replace(end=tick), None
        self.first = self.first or outage
        self.outages += 1
        self.ticks += outage.end - outage.begin

    def _unreached(self) -> tuple[int, ...]:
        reached = set(self._roots)
        front: list[int] = list(self._roots)
        while front:
            src = front.pop()
            for dst in self._hearers.get(src, ()):
                if dst not in reached and (src, dst) in self._last:
                    reached.add(dst)
                    front.append(dst)
        return tuple(i for i in self._wanted if i not in reached)
