"""One agent's place in the lockstep: wait until the inbox is known up to the tick, then step.

A pure state machine: messages in, messages out; `AgentProcess` adds zenoh, the in-process run adds nothing. On an
ideal network the agent transmits first and decides once its inbox of the same tick is there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from agents.sample import Decision
from netem.errors import OutOfPlace
from netem.wire.messages import Arrival, Command, Delivery, Inbox, Nav, Receipt, Transmission

Answer = Transmission | Command | Receipt  # a receipt only on a wall clock


class AgentCore(Protocol):
    """The methods of an agent that the lockstep calls."""

    def transmit(self, nav: Nav, /) -> tuple[bytes, ...]:
        """The payloads of a round tick; asked before the decision of that tick."""

    def decide(self, nav: Nav, deliveries: list[Delivery], /) -> Decision:
        """Answer one sample."""

    def take_notes(self) -> list[tuple[int, str]]:
        """(tick, text) of what a person should know since the last call."""


class AgentLoop:
    """Feeds an agent core with navs and inboxes in the right order."""

    def __init__(
        self,
        core: AgentCore,
        round_ticks: int,
        *,
        incarnation: int = 0,
        begin: int = 0,
        ideal: bool = False,
    ) -> None:
        """Begin life `incarnation` (from 0) of an agent, with the nav of tick `begin`.

        Args:
            ideal: packets arrive in the tick in which they are sent. The agent then transmits before it decides.
        """
        self.core = core
        self.round_ticks = round_ticks
        self.incarnation = incarnation
        self.ideal = ideal
        # The inbox is known up to this tick: earlier messages are not for this life.
        self._known = begin - 1 if ideal else begin
        self._tick = begin - 1  # last tick answered, or before the first
        self._nav: Nav | None = None
        self._transmitted = False
        self._deliveries: list[Delivery] = []

    @property
    def tick(self) -> int:
        """The last tick that was answered. Before the first answer: the tick before the first nav."""
        return self._tick

    @property
    def waits_for_inbox(self) -> bool:
        """Whether a nav has come, and its inbox is still missing."""
        return self._nav is not None

    def take_over(self, before: AgentLoop, *, anew: bool) -> None:
        """Go on at the first tick for the agent of another run, with its deliveries that were not due yet. `anew`: with
        the own core, which begins without memory.
        """
        self._deliveries = before._deliveries
        if not anew:
            self.core = before.core

    @property
    def waiting(self) -> tuple[Delivery, ...]:
        """The deliveries that are not due yet."""
        return tuple(self._deliveries)

    def nav(self, nav: Nav) -> list[Answer]:
        """Take the nav of the next tick, or of a later one when the agent was suspended in between. Raises OutOfPlace
        if it is of a later incarnation, or of a tick before the next.
        """
        if not self._is_mine(nav.incarnation):
            return []
        if self._nav is not None or nav.tick <= self._tick:
            raise OutOfPlace("nav tick", self._tick + 1 + (self._nav is not None), nav.tick)
        self._nav = nav
        return self._advance()

    def inbox(self, inbox: Inbox) -> list[Answer]:
        """Take the next round's deliveries. Raises OutOfPlace: a later incarnation's, or not the next round."""
        if not self._is_mine(inbox.incarnation):
            return []
        expected = max(0, self._known + self.round_ticks)
        if inbox.until != expected:
            raise OutOfPlace("inbox until tick", expected, inbox.until)
        self._deliveries.extend(inbox.deliveries)
        if inbox.more:
            return []
        self._known = inbox.until
        return self._advance()

    def _advance(self) -> list[Answer]:
        nav = self._nav
        if nav is None:
            return []
        out: list[Answer] = []
        sends = nav.tick % self.round_ticks == 0
        if self.ideal and sends and not self._transmitted:
            self._transmitted = True
            out.append(Transmission(self.incarnation, nav.tick, self.core.transmit(nav)))
        if self._known < nav.tick:
            return out
        if not self.ideal and sends:
            out.append(Transmission(self.incarnation, nav.tick, self.core.transmit(nav)))
        tau, telemetry, said = self.core.decide(nav, self._due(nav.tick))
        out.append(Command(self.incarnation, nav.tick, tau, telemetry, said))
        self._nav, self._tick, self._transmitted = None, nav.tick, False
        return out

    def _due(self, tick: int) -> list[Delivery]:
        # Deliveries of one inbox come sorted, and every later inbox is due later: the list stays sorted.
        waiting = self._deliveries
        if not waiting or waiting[0].due_tick > tick:
            return []
        due = 1
        while due < len(waiting) and waiting[due].due_tick <= tick:
            due += 1
        self._deliveries = waiting[due:]
        return waiting[:due]

    def _is_mine(self, incarnation: int) -> bool:
        """Whether a message is for this life of the agent: one for the life before may come late."""
        if incarnation > self.incarnation:
            raise OutOfPlace("incarnation", self.incarnation, incarnation)
        return incarnation == self.incarnation


class RealtimeLoop(AgentLoop):
    """Feeds an agent core on a wall clock: it answers at once, with the deliveries that have come in and are due.

    Of navs that queued up while it computed it answers the newest. Before that it answers the last one of a round tick,
    if there is one, so that its neighbours hear it.
    """

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
        """The navs to answer among those that are there, oldest first."""
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
        tau, telemetry, said = self.core.decide(nav, taken)
        out.append(Command(self.incarnation, nav.tick, tau, telemetry, said))
        if taken:
            arrivals = (Arrival(*name, self._at_ns.pop(name)) for name in ((d.src, d.seq, d.copy) for d in taken))
            out.append(Receipt(self.incarnation, nav.tick, tuple(arrivals)))
        return out
