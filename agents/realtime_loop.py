"""One agent on a wall clock: it answers the newest nav at once, with the deliveries that have come in and are due.

A pure state machine like `AgentLoop`. Of navs that queued up while it computed it answers the newest, and before that
the last one of a round tick, if there is one, so that its neighbours hear it.
"""

from __future__ import annotations

from collections.abc import Sequence

from agents.loop import AgentCore, AgentLoop, Answer
from netem.errors import OutOfPlace
from netem.wire.messages import Arrival, Command, Inbox, Nav, Receipt, Transmission


class RealtimeLoop(AgentLoop):
    """Feeds an agent core with navs and with the deliveries that are due."""

    def __init__(self, core: AgentCore, round_ticks: int, *, incarnation: int = 0, begin: int = 0) -> None:
        super().__init__(core, round_ticks, incarnation=incarnation, begin=begin)
        self._at_ns: dict[tuple[int, int, int], int] = {}  # when each delivery that is kept came in

    def arrive(self, inbox: Inbox, at_ns: int) -> None:
        """Keep what came in at `at_ns` [ns, CLOCK_MONOTONIC] until it is due. Raises OutOfPlace if it is of a later
        incarnation.
        """
        if self._is_mine(inbox.incarnation):
            self._deliveries += inbox.deliveries
            self._at_ns |= {(d.src, d.seq, d.copy): at_ns for d in inbox.deliveries}

    def to_answer(self, navs: Sequence[Nav]) -> list[Nav]:
        """Of the navs that are there those to answer, oldest first."""
        newest = navs[-1]
        sends = next((nav for nav in reversed(navs) if nav.tick % self.round_ticks == 0), newest)
        return [newest] if sends is newest else [sends, newest]

    def nav(self, nav: Nav) -> list[Answer]:
        """Answer a nav. Raises OutOfPlace: a later incarnation's, or not newer than the one before."""
        if not self._is_mine(nav.incarnation):
            return []
        if nav.tick <= self._tick:
            raise OutOfPlace("nav tick", self._tick + 1, nav.tick)
        self._tick = nav.tick
        taken = self._due(nav.tick)
        out: list[Answer] = []
        if nav.tick % self.round_ticks == 0:
            out.append(Transmission(self.incarnation, nav.tick, self.core.transmit(nav)))
        tau, telemetry = self.core.decide(nav, taken)
        out.append(Command(self.incarnation, nav.tick, tau, telemetry))
        if taken:
            arrivals = (Arrival(*name, self._at_ns.pop(name)) for name in ((d.src, d.seq, d.copy) for d in taken))
            out.append(Receipt(self.incarnation, nav.tick, tuple(arrivals)))
        return out
