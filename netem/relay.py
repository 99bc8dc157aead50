"""The network between robots that are not ours: it takes messages when they come, and gives them out when due.

`Relay` is pure: its caller gives the time [ns, CLOCK_MONOTONIC]. Its media are those of a run in lockstep. So the fate
of the n-th packet of a link is a function of (seed, link, n). Links delay each packet to the nanosecond. Faults, rates
and records have the grain of a tick. The acoustic channel works in ticks, so a message starts at the next one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from heapq import heappop, heappush
from types import MappingProxyType
from typing import Any, NamedTuple

from msgspec import structs

from netem.acoustic import AcousticChannel
from netem.cause import Cause
from netem.condition import Link
from netem.config import NetemConfig
from netem.correlation import lost_share
from netem.endpoint import HeardFrame, ModemEndpoint
from netem.faults import ActiveFaults, active_faults, release_tick
from netem.histogram import Histogram
from netem.limits import LINK_UNDER_WAY
from netem.links import make_links
from netem.medium import IndependentLinks, MediumRound, Place
from netem.modem_news import ModemNews, tell
from netem.network import fate_order
from netem.robot_message import MODEM, PUT, RobotMessage
from netem.transit import HeldPacket, PendingPacket, Transit
from netem.wire.messages import Fate, MeasuredRange


class MessageFate(Fate, frozen=True):
    """The fate of a packet, and the message that it belongs to."""

    key: str = ""  # zenoh's, `udp/<port>`, or `modem/<address>/<protocol>`
    kind: str = PUT
    size: int = 0  # bytes, with the header


class PacketPart(NamedTuple):
    """A packet's share of a message: number `part` of `parts`, of `length` bytes without the header."""

    message: RobotMessage
    part: int
    parts: int
    length: int


class DueMessage(NamedTuple):
    """A message that is due at a receiver, with the packet that it came with."""

    due_ns: int
    dst: int
    message: RobotMessage
    payload: bytes
    packet: PendingPacket
    part: PacketPart


class _Outbox(Transit):
    """Where media put packets and losses."""

    def __init__(self, config: NetemConfig) -> None:
        super().__init__(config)
        self.now: PacketPart | None = None  # what enters a link now; None: in water, where `named` says it
        self.named: dict[tuple[int, int], PacketPart] = {}  # by (src, seq): which message a packet in water belongs to
        self.heap: list[tuple[int, int, PendingPacket, PacketPart]] = []
        self._parts: dict[tuple[int, int, int, int], PacketPart] = {}  # the messages of packets that a fault holds
        self.sizes: Counter[Link] = Counter()  # bytes under way
        self.full: set[Link] = set()  # links that have lost something because so much was under way
        self.final: list[MessageFate] = []
        self.begin_ns = self.reported = 0  # nothing becomes final before this tick any more
        self._count = 0

    def add(self, packet: PendingPacket, measured: MeasuredRange | None = None) -> None:
        part = self._parts.pop(packet.name, None)  # faults have the grain of a tick
        if part is None and not self._fits(packet):
            return
        if part is None and self.now is not None:
            part = self.now
            due_ns = part.message.at_ns + packet.delay_ns
        else:
            part = part or self.named[packet.src, packet.seq]
            due_ns = self.begin_ns + packet.due_tick * self._tick_ns
        self._count += 1
        heappush(self.heap, (due_ns, self._count, packet, part))

    def hold(self, held: HeldPacket) -> None:
        if self._fits(held.packet):
            super().hold(held)
            assert self.now is not None
            self._parts[held.packet.name] = self.now

    def _fits(self, packet: PendingPacket) -> bool:
        """Count a packet as under way, or lose it: so much is under way in its link already."""
        link, size = (packet.src, packet.dst), len(packet.payload)
        if self.sizes[link] and self.sizes[link] + size > LINK_UNDER_WAY.bytes:
            self.full.add(link)
            self.lose(packet.fate(packet.sent_tick, Cause.QUEUE))
            return False
        self.sizes[link] += size
        return True

    def all_held(self) -> list[tuple[PendingPacket, PacketPart]]:
        """What faults hold still, for the end of the run."""
        packets = [held.packet for all_held in self.held.values() for held in all_held]
        self.held = {}
        return [(packet, self._parts.pop(packet.name)) for packet in packets]

    def lose(self, fate: Fate) -> None:
        part = self.now or self.named[fate.src, fate.seq]
        self.final.append(message_fate(fate, part, max(fate.final_tick, self.reported)))
        if self.spoiled is not None:
            self.spoiled.append(fate)


def message_fate(fate: Fate, part: PacketPart, final_tick: int) -> MessageFate:
    """A fate with its message; `fate.payload` is the packet as it was sent, and is not kept."""
    return MessageFate(
        final_tick, fate.src, fate.dst, fate.seq, fate.copy, fate.sent_tick, fate.due_tick, fate.delay_ns,
        fate.cause, fate.corrupted, b"", None, part.message.key, part.message.kind, len(fate.payload),
    )  # fmt: skip


class Relay:
    """The packets between robots. `now_ns` never goes back from call to call."""

    def __init__(
        self,
        config: NetemConfig,
        begin_ns: int,
        *,
        header: int = 0,
        fragments: bool = False,
        modems: Mapping[int, ModemEndpoint] = MappingProxyType({}),
    ) -> None:
        """Begin.

        Args:
            config: of the network.
            begin_ns: when tick 0 begins.
            header: bytes that each packet has beside its payload.
            fragments: in water, a message that is longer than a packet is sent as several, which must all arrive.
            modems: in water, by robot, modems that its programs open.
        """
        water = config.acoustic is not None
        self.config = config = replace(config, ideal=not water, round_ticks=1)
        self.faults = config.faults
        self.late = Histogram()  # how much later than due messages were handed over
        self.places: dict[int, Place] = {}
        self._begin_ns, self._header = begin_ns, bytes(header)
        self._room: dict[int, int] = {}  # by sender: bytes of a message that fit into a packet; empty: any number
        if fragments and config.acoustic is not None:
            self._room = {i: max(1, config.acoustic.longest(config.tick_ns, i) - header) for i in config.vehicles}
        self._links, self._out = make_links(config), _Outbox(config)
        self._links_of = {src: [(src, dst) for dst in all_dst] for src, all_dst in self._links.receivers.items()}
        self._out.begin_ns = begin_ns
        self._dry = None if water else IndependentLinks(config, self._links, self._out)
        self._water = AcousticChannel(config, self._links, self._out) if water else None
        self._modems, self._news = modems, None
        if modems and self._water is not None:
            self._news = ModemNews(config, self._water, self._out, self._called)
        self._taken = 0
        self._leaving: dict[int, DueMessage] = {}  # given out by `due_messages` and not yet settled, by identity
        self._came: dict[int, list[tuple[PacketPart, bytes]]] = {}  # in water: what leaves at the next tick
        self._numbers = dict.fromkeys(config.vehicles, 0)  # in water: the number of the next packet, by sender
        self._next = 0  # tick of the next round, in water
        self._arrived: dict[tuple[int, int], dict[int, bytes]] = {}  # parts by (receiver, message)
        self._latency_ns: dict[Link, int] = {}
        self._active: tuple[int, tuple[Any, ...], ActiveFaults] = (-1, (), active_faults((), 0))

    @property
    def entered(self) -> dict[Link, tuple[int, int]]:
        """The number of packets sent into each link, and the number of duplicates that the link added."""
        return {link: (account.sent, account.duplicated) for link, account in self._links.ledger.accounts.items()}

    def tick(self, now_ns: int) -> int:
        return max(0, (now_ns - self._begin_ns) // self.config.tick_ns)

    def due_ns(self) -> int | None:
        """When there is something to do next; None: not before a message comes."""
        due = self._out.heap[0][0] if self._out.heap else None
        for link, held in self._out.held.items():
            if (end := release_tick(self.faults, link, held[0].packet.sent_tick)) is not None:
                end_ns = self._begin_ns + end * self.config.tick_ns
                due = end_ns if due is None else min(due, end_ns)
        if self._water is None:
            return due
        carries = self._begin_ns + self._next * self.config.tick_ns
        return carries if due is None else min(due, carries)

    def take(self, message: RobotMessage) -> None:
        """Send a message into the links of its sender, or the only one to its receiver."""
        src = message.src
        self._taken = message.number = self._taken + 1
        parts = self._parts(message)
        if self._water is not None:
            self._came.setdefault(src, []).extend(parts)
            return
        tick, out = self.tick(message.at_ns), self._out
        faults = self._faults(tick)
        assert self._dry is not None
        for link in self._ways(message):
            for part, data in parts:
                out.now = part
                self._dry.enter(tick, link, data, faults)
        out.now = None

    def refuse(self, message: RobotMessage, size: int) -> None:
        """Lose a message of `size` bytes, whose payload is not kept, before it enters a link: too much waits."""
        self._out.now, data = PacketPart(message, 0, 1, size), bytes(size) + self._header
        if self._water is not None:
            self._water.refuse(self._next, message.src, data)
            self._numbers[message.src] += 1
        elif self._dry is not None:
            links = self._ways(message)
            cut = self._faults(self.tick(message.at_ns))._replace(cut=dict.fromkeys(links, Cause.QUEUE))
            for link in links:
                self._dry.enter(self.tick(message.at_ns), link, data, cut)
        self._out.now = None

    def due_messages(self, now_ns: int) -> Iterator[DueMessage]:
        """Every message that is due, in that order. The caller says with `settle` what became of each, and counts in
        `late` how late it was handed over.
        """
        out = self._out
        if out.held:
            out.release(self.faults, self.tick(now_ns))
        while self._water is not None and self._begin_ns + self._next * self.config.tick_ns <= now_ns:
            self._carry(self._water)
        while out.heap and out.heap[0][0] <= now_ns:
            due_ns, _, packet, part = heappop(out.heap)
            out.sizes[packet.src, packet.dst] -= len(packet.payload)
            if packet.dst in self._faults(self._final_tick(packet, now_ns)).deaf:
                self._end(packet, part, now_ns, Cause.DEAF)
                continue
            self._latency_ns[packet.src, packet.dst] = packet.delay_ns
            payload = self._whole(packet, part)
            if payload is None or part.message.to not in (None, packet.dst):
                self._end(packet, part, now_ns, Cause.DELIVERED)
                continue
            due = DueMessage(due_ns, packet.dst, part.message, payload, packet, part)
            self._leaving[id(due)] = due
            yield due

    @property
    def empty(self) -> bool:
        """Whether nothing is under way, and everything that was given out is settled."""
        in_water = self._water is not None and bool(self._water.under_way())
        return not (self._out.heap or self._leaving or self._came or in_water)

    def gave(self, due: DueMessage) -> bool:
        """Whether a message was given out by this relay, and is not settled."""
        return id(due) in self._leaving

    def settle(self, due: DueMessage, at_ns: int, *, delivered: bool) -> None:
        """A message that was due has been handed over, or its receiver did not take it."""
        del self._leaving[id(due)]
        self._end(due.packet, due.part, at_ns, Cause.DELIVERED if delivered else Cause.RECEIVER)

    def report(self, until: int) -> list[MessageFate]:
        """The fates that became final up to a tick, in the order of the log."""
        final = [fate for fate in self._out.final if fate.final_tick <= until]
        self._out.final = [fate for fate in self._out.final if fate.final_tick > until]
        self._out.reported = until + 1
        final.sort(key=fate_order)
        return final

    def close(self, end_tick: int) -> list[MessageFate]:
        """The fates of everything that is left when the run ends before a tick is started."""
        final = self.report(end_tick - 1)
        if self._water is not None:
            self._water.close(end_tick)
        heap = self._out.heap
        under_way = [(packet, part) for _, _, packet, part in heap] + self._out.all_held()
        under_way += [(due.packet, due.part) for due in self._leaving.values()]
        self._leaving = {}
        rest = [message_fate(packet.fate(end_tick, Cause.IN_FLIGHT), part, end_tick) for packet, part in under_way]
        lost = [structs.replace(fate, final_tick=end_tick, cause=Cause.IN_FLIGHT) for fate in self._out.final]
        self._out.heap, self._out.final = [], []
        return final + sorted([*rest, *lost], key=fate_order)

    def passes(self, link: Link, now_ns: int) -> bool:
        """Whether a packet could pass a link now, wherever its ends are."""
        faults, model = self._faults(self.tick(now_ns)), self._links.models[link]
        if link in faults.cut or link in faults.hold or link[0] in faults.mute or link[1] in faults.deaf:
            return False
        condition = faults.conditions.get(link, model.condition)
        return lost_share(condition) < 1.0 or link in faults.up

    def latency_ns(self, link: Link) -> int:
        """The delay of the last packet that arrived over a link, or what its condition says before there is one."""
        return self._latency_ns.get(link, self._links.models[link].condition.delay_ns)

    @property
    def full(self) -> set[Link]:
        """The links that lost something because too many bytes were under way."""
        return self._out.full

    def _final_tick(self, packet: PendingPacket, at_ns: int) -> int:
        return max(packet.sent_tick, self.tick(at_ns), self._out.reported)

    def _end(self, packet: PendingPacket, part: PacketPart, at_ns: int, cause: Cause) -> None:
        tick = self._final_tick(packet, at_ns)
        self._out.final.append(message_fate(packet._replace(due_tick=tick).fate(tick, cause), part, tick))

    def _faults(self, tick: int) -> ActiveFaults:
        if self._active[0] != tick or self._active[1] is not self.faults:
            self._active = tick, self.faults, active_faults(self.faults, tick)
        return self._active[2]

    def _parts(self, message: RobotMessage) -> list[tuple[PacketPart, bytes]]:
        payload = message.payload
        room = self._room.get(message.src, 0) or len(payload) or 1
        pieces = [payload[begin : begin + room] for begin in range(0, len(payload), room)] or [b""]
        return [
            (PacketPart(message, number, len(pieces), len(piece)), piece + self._header)
            for number, piece in enumerate(pieces)
        ]

    def _ways(self, message: RobotMessage) -> list[Link]:
        """The links that a message enters."""
        links = self._links_of[message.src]
        return links if message.to is None else [link for link in links if link[1] == message.to]

    def _carry(self, water: AcousticChannel) -> None:
        tick = self._next
        came = {src: tuple(data for _, data in parts) for src, parts in self._came.items()}
        starts: dict[tuple[int, int], int] = {}
        for src, parts in self._came.items():
            for number, (part, _) in enumerate(parts, self._numbers[src]):
                self._out.named[src, number] = part
                if part.message.kind == MODEM and (at_ns := part.message.what.at_ns) is not None:
                    starts[src, number] = -(-(at_ns - self._begin_ns) // self.config.tick_ns)
            self._numbers[src] += len(parts)
        self._came = {}
        water.carry(MediumRound(tick, tick + 1, came, self.places, self._faults(tick), starts=starts))
        self._next = tick + 1
        if self._news is not None:
            self._tell_modems(self._news)
        if came:
            named, under_way = self._out.named, water.under_way()
            self._out.named = {name: part for name, part in named.items() if name in under_way}

    def _tell_modems(self, news: ModemNews) -> None:
        """Tell modems what begins to be transmitted, where it is heard, and what is lost before or spoiled there."""
        for i, event in news.take(self._modems):
            tell(self._modems[i], event, self._begin_ns)

    def _called(self, src: int, seq: int) -> int | None:
        """What a modem calls a payload of its own."""
        part = self._out.named.get((src, seq))
        return None if part is None or part.message.kind != MODEM else part.message.what.tag

    def frame_of(self, due: DueMessage) -> HeardFrame | None:
        """The frame that a modem hears with a message that is due. None: the message is damaged, and a modem has
        checksums.
        """
        if due.packet.corrupted or self._news is None:
            return None
        request = due.message.what
        return self._news.arrival(due.packet, self.places).frame(
            request.src, request.to, request.what, due.payload, request.head, self._begin_ns
        )

    def hand_to(self, modem: ModemEndpoint, due: DueMessage) -> None:
        """Hand a message that is due to a modem: its frame, or the news that it is damaged."""
        if (frame := self.frame_of(due)) is not None:
            modem.on_heard(frame)
        elif self._news is not None:
            tell(modem, self._news.damaged_frame(due.packet), self._begin_ns)

    def _whole(self, packet: PendingPacket, part: PacketPart) -> bytes | None:
        """The payload that has arrived with a packet; None: parts of it are missing, or it was there already."""
        data = packet.payload[: part.length]
        if part.parts == 1:
            return data
        name = packet.dst, part.message.number
        have = self._arrived.setdefault(name, {})
        have[part.part] = data
        if len(have) < part.parts:
            if len(self._arrived) > LINK_UNDER_WAY.items:
                del self._arrived[next(iter(self._arrived))]
            return None
        del self._arrived[name]
        return b"".join(have[number] for number in range(part.parts))
