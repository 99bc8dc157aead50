"""The network on a wall clock: it takes packets in every tick, and hands each one out a tick before it is due.

`RealtimeRounds` is a pure state machine like `Rounds`. The process decides when a tick is exchanged. If a transmission
of round tick k comes in the first half of tick k, it enters the network at k, as in lockstep. If it comes later, it
enters at its tick of arrival, and the delay of the network counts from there. The impairment models are the same as in
lockstep, and so is the least latency of one tick.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from msgspec.structs import astuple

from netem.condition import Link
from netem.config import NetemConfig
from netem.errors import OutOfPlace
from netem.histogram import Histogram
from netem.lives import Lives
from netem.network import Netem
from netem.wire.messages import Delivery, Fate, Inbox, LinkReport, Receipt, Round, Transmission

FAR_ROUNDS = 20  # an agent may be ahead of a late network by so many rounds


@dataclass(slots=True)
class Handed:
    """A delivery that its receiver has not acknowledged."""

    due_tick: int
    sent_tick: int
    put_ns: int


class RealtimeRounds:
    """Gives `Netem` what has come, tick by tick."""

    def __init__(self, config: NetemConfig) -> None:
        self.config = config
        every_tick = replace(config, round_ticks=1)
        self.netem = Netem(every_tick)
        self.lives = Lives(config.absences)
        self.late = dict.fromkeys(config.vehicles, 0)  # transmissions that entered after their tick
        self._tick = 0  # exchanged next
        self._sent = dict.fromkeys(config.vehicles, -config.round_ticks)
        self._owed: dict[int, set[int]] = {i: set() for i in config.vehicles}  # round ticks without a transmission
        self._resumed = dict.fromkeys(config.vehicles, 0)  # to a round: no longer suspended from then on
        self._life = dict.fromkeys(config.vehicles, 0)  # to which deliveries were handed out last
        self._came: dict[int, list[bytes]] = {}
        self._round: Round | None = None
        self._fates: list[Fate] = []
        self._handed: dict[int, dict[tuple[int, int, int], Handed]] = {i: {} for i in config.vehicles}
        self.injected: dict[Link, Histogram] = {link: Histogram() for link in config.links}
        self.measured: dict[Link, Histogram] = {link: Histogram() for link in config.links}
        self.hop = Histogram()
        self.margin = Histogram()
        self.overdue = 0  # deliveries used after their due tick

    @property
    def tick(self) -> int:
        return self._tick

    @property
    def missing(self) -> list[int]:
        """No vehicle: in real time the network waits for none."""
        return []

    @property
    def known(self) -> bool:
        """Whether the world has said where everyone is at that tick, to the accuracy of a round."""
        return self._round is not None and self._tick < self._round.tick + self.config.round_ticks

    def transmission(self, i: int, message: Transmission) -> None:
        """Take vehicle i's transmission, whenever it comes. Raises OutOfPlace: not a round tick, a tick that was taken
        already or lies in the future, or another incarnation."""
        self.lives.check(i, message.tick, message.incarnation)
        m = self.config.round_ticks
        last = self._sent[i]
        latest = self._tick + FAR_ROUNDS * m
        if message.tick % m or message.tick <= last or message.tick > latest:
            raise OutOfPlace("round tick", f"one after {last}, up to {latest}", message.tick)
        self.late[i] += message.tick < self._tick
        self._owed[i].discard(message.tick)
        self._sent[i] = message.tick
        self._came.setdefault(i, []).extend(message.payloads)

    def round(self, message: Round) -> None:
        """Take from the world who is alive at a round tick, who of them is suspended, and where they are."""
        self._round = message
        for i in message.paused:
            self._resumed[i] = message.tick + self.config.round_ticks
        for i in {*message.alive} - {*message.paused}:
            if self._sent[i] < message.tick:
                self._owed[i].add(message.tick)

    def exchange(self, now_ns: int) -> tuple[list[tuple[int, Inbox]], LinkReport | None]:
        """The outcome of a tick: (vehicle, inbox) pairs of the vehicles that get something, and at a round tick the
        report.
        """
        tick = self._tick
        inboxes = []
        for i, deliveries in self._advance().items():
            if deliveries:
                incarnation = self.lives.incarnation(i, tick)
                if incarnation != self._life[i]:
                    self._life[i] = incarnation
                    self._handed[i].clear()
                handed = self._handed[i]
                handed |= {(d.src, d.seq, d.copy): Handed(d.due_tick, d.sent_tick, now_ns) for d in deliveries}
                inboxes.append((i, Inbox(incarnation, tick + 1, False, deliveries)))
        if tick % self.config.round_ticks:
            return inboxes, None
        report = LinkReport(tick, False, False, tuple(self._fates))
        self._fates = []
        return inboxes, report

    def _advance(self) -> dict[int, tuple[Delivery, ...]]:
        where = self._round
        assert where is not None  # `known`
        positions = dict(zip(where.alive, where.positions, strict=True))
        came = {i: tuple(payloads) for i, payloads in self._came.items() if i in positions}
        self._came = {}
        inboxes, fates = self.netem.exchange(self._tick, came, positions)
        self._fates += fates
        self._tick += 1
        return inboxes

    def receipt(self, i: int, receipt: Receipt, due_ns: Callable[[int], int]) -> None:
        """Take the report of vehicle i about the deliveries that it used at a tick. `due_ns`: returns the begin of a
        tick [ns, CLOCK_MONOTONIC]. Raises OutOfPlace: the report is from another incarnation, or names a delivery that
        the agent did not get."""
        self.lives.check(i, receipt.tick, receipt.incarnation)
        tick_ns = self.config.tick_ns
        for arrival in receipt.arrivals:
            src, seq, copy, at_ns = astuple(arrival)
            handed = self._handed[i].pop((src, seq, copy), None)
            if handed is None:
                raise OutOfPlace("arrival", "a delivery that was handed out", f"{src}->{i} number {seq} copy {copy}")
            self.injected[src, i].add((handed.due_tick - handed.sent_tick) * tick_ns)
            self.measured[src, i].add((receipt.tick - handed.sent_tick) * tick_ns)
            self.hop.add(at_ns - handed.put_ns)
            self.margin.add(due_ns(handed.due_tick) - at_ns)
            self.overdue += receipt.tick > max(handed.due_tick, self._resumed[i])

    def close(self, end_tick: int) -> LinkReport:
        """The last report, after every tick that was not exchanged yet."""
        while self._tick < end_tick and self._round is not None:
            self._advance()
        return LinkReport(end_tick, True, False, (*self._fates, *self.netem.close(end_tick)))

    def timing(self) -> dict[str, Any]:
        """The measured times of the agents and of the network itself, as plain values."""
        alive = () if self._round is None else self._round.alive
        links = {
            f"{src}->{dst}": {"injected": self.injected[src, dst].to_values(), "measured": spread.to_values()}
            for (src, dst), spread in sorted(self.measured.items())
        }
        return {
            "links": links,
            "hop": self.hop.to_values(),
            "margin": self.margin.to_values(),
            "overdue": self.overdue,
            "unread": sum(len(handed) for i, handed in self._handed.items() if i in alive),
            "late": {str(i): n for i, n in self.late.items()},
            "missed": {str(i): len(owed) for i, owed in self._owed.items()},
        }
