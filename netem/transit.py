"""The packets without a final fate: under way, in an inbox but not yet due, or lost at a tick to come."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterable
from typing import NamedTuple

from msgspec.structs import replace

from netem.cause import Cause
from netem.condition import Link
from netem.config import NetemConfig
from netem.faults import ActiveFaults, NetFault, release_tick
from netem.vehicle_clock import Clocks
from netem.wire.messages import Delivery, Fate, MeasuredRange


class PendingPacket(NamedTuple):
    """A payload under way. Packets sort in the order of their delivery."""

    due_tick: int
    sent_tick: int
    src: int
    seq: int
    copy: int
    dst: int
    delay_ns: int
    payload: bytes
    corrupted: bool

    def fate(self, final_tick: int, cause: Cause, measured: MeasuredRange | None = None) -> Fate:
        return Fate(
            final_tick,
            self.src,
            self.dst,
            self.seq,
            self.copy,
            self.sent_tick,
            self.due_tick,
            self.delay_ns,
            cause,
            self.corrupted,
            self.payload,
            measured,
        )

    @property
    def name(self) -> tuple[int, int, int, int]:
        return self.dst, self.src, self.seq, self.copy


class HeldPacket(NamedTuple):
    """A packet that a fault holds."""

    packet: PendingPacket  # the packet with the times that it would have without the fault
    later: int  # ticks between it and the packet that it is a copy of, also after the fault
    reverse: bool


def with_sender_time(delivery: Delivery, clocks: Clocks) -> Delivery:
    """The same with the time of sending by the clock of its sender, as its modem stamps it."""
    return replace(delivery, sent_tick=clocks.reading_ticks(delivery.src, delivery.sent_tick))


def with_range(delivery: Delivery, measured: MeasuredRange) -> Delivery:
    """The same with its range, as its receiver knows it."""
    return replace(delivery, range_m=measured.range_m, range_sd_m=measured.sd_m, range_tick=measured.tick)


class Transit:
    """The packets under way. A medium adds packets and losses; each round takes inboxes and final fates out."""

    def __init__(self, config: NetemConfig) -> None:
        self.pending: dict[int, list[PendingPacket]] = {
            i: [] for i in config.vehicles
        }  # heaps of what is in no inbox yet
        self._tick_ns = config.tick_ns
        self.announced: list[PendingPacket] = []  # packets that are in an inbox and not yet due
        self.lost: list[Fate] = []  # losses whose final tick is still to come
        self.spoiled: list[Fate] | None = None  # the last losses, for modems that want to know; None: none does
        self.ranges: dict[tuple[int, int, int, int], MeasuredRange] = {}  # packets without a final fate have one
        self.held: dict[Link, list[HeldPacket]] = {}  # packets that faults hold, in the order of sending
        self._reversed: set[tuple[int, int, int, int]] = set()  # released, and in no inbox yet

    def take_over(self, before: Transit) -> None:
        """Go on with what is under way in another run."""
        self.pending, self.announced, self.lost = before.pending, before.announced, before.lost
        self.ranges, self.held, self._reversed = before.ranges, before.held, before._reversed

    def add(self, packet: PendingPacket, measured: MeasuredRange | None = None) -> None:
        heapq.heappush(self.pending[packet.dst], packet)
        if measured is not None:
            self.ranges[packet.name] = measured

    def hold(self, held: HeldPacket) -> None:
        """Keep a packet until `release`."""
        self.held.setdefault((held.packet.src, held.packet.dst), []).append(held)

    def release(self, faults: tuple[NetFault, ...], until: int, earliest: int = 0) -> None:
        """Send what faults held on its way, if they end up to tick `until`. None of it is due before `earliest`."""
        for link, all_held in [*self.held.items()]:
            end = release_tick(faults, link, all_held[0].packet.sent_tick)
            if end is not None and end <= until:
                del self.held[link]
                backwards = [held for held in reversed(all_held) if held.reverse]
                for held in (*backwards, *(held for held in all_held if not held.reverse)):
                    self._set_free(held, max(end, earliest))

    def _set_free(self, held: HeldPacket, end: int) -> None:
        packet, later = held.packet, held.later
        if (due := max(packet.due_tick - later, end) + later) > packet.due_tick:
            packet = packet._replace(due_tick=due, delay_ns=(due - packet.sent_tick) * self._tick_ns)
        if held.reverse:
            self._reversed.add(packet.name)
        self.add(packet)

    def hand_over(self, packets: Iterable[tuple[PendingPacket, MeasuredRange | None]]) -> None:
        for packet, measured in packets:
            self.add(packet, measured)

    def lose(self, fate: Fate) -> None:
        """A packet is lost; the fate is reported once its final tick is reached."""
        self.lost.append(fate)
        if self.spoiled is not None:
            self.spoiled.append(fate)

    def announce(
        self, alive: Collection[int], until: int, faults: ActiveFaults, clocks: Clocks | None = None
    ) -> tuple[dict[int, tuple[Delivery, ...]], list[Fate]]:
        """Inboxes of the living with what is due up to tick `until`, and what is lost at receivers that cannot hear.
        `clocks`: that stamp what is sent; None: all are right."""
        inboxes = {}
        unheard = []
        for i in sorted(self.pending):
            queue, inbox = self.pending[i], []
            cause = Cause.DEAD_RECEIVER if i not in alive else Cause.DEAF if i in faults.deaf else None
            while queue and queue[0].due_tick <= until:
                packet = heapq.heappop(queue)
                if cause is not None:
                    unheard.append(packet.fate(packet.due_tick, cause))
                    self.ranges.pop(packet.name, None)
                else:
                    self.announced.append(packet)
                    delivery = Delivery(*packet[:5], packet.payload)
                    if self.ranges and (measured := self.ranges.get(packet.name)) is not None:
                        delivery = with_range(delivery, measured)
                    inbox.append(delivery if clocks is None else with_sender_time(delivery, clocks))
            if self._reversed:
                last = self._reversed  # comes first among what is due at the same tick
                inbox.sort(
                    key=lambda d: (d.due_tick, *((-d.sent_tick, -d.seq) if (i, d.src, d.seq, d.copy) in last else (1,)))
                )
            if i in alive:
                inboxes[i] = tuple(inbox)
        self._reversed.clear()
        return inboxes, unheard

    def settle(self, until: int) -> list[Fate]:
        due = [packet for packet in self.announced if packet.due_tick <= until]
        if due:
            self.announced = [packet for packet in self.announced if packet.due_tick > until]
        final = [fate for fate in self.lost if fate.final_tick <= until]
        if final:
            self.lost = [fate for fate in self.lost if fate.final_tick > until]
        if not self.ranges:
            return [packet.fate(packet.due_tick, Cause.DELIVERED) for packet in due] + final
        take = self.ranges.pop
        return [packet.fate(packet.due_tick, Cause.DELIVERED, take(packet.name, None)) for packet in due] + final

    def close(self, end_tick: int) -> list[Fate]:
        """The fates of everything that is left when the run ends before tick `end_tick` is started."""
        fates = self.settle(end_tick - 1)
        rest = self.announced + [p for i in sorted(self.pending) for p in self.pending[i]]
        rest += [held.packet for link in sorted(self.held) for held in self.held[link]]
        fates += [packet.fate(end_tick, Cause.IN_FLIGHT) for packet in rest]
        fates += [replace(fate, final_tick=end_tick, cause=Cause.IN_FLIGHT) for fate in self.lost]
        self.announced, self.lost, self.pending, self.ranges = [], [], {i: [] for i in self.pending}, {}
        self.held = {}
        return fates
