"""Ranges: what a modem measures of the distance to the sender of a packet, by the time that the sound took.

| symbol | meaning | unit |
|---|---|---|
| d | true distance, at the round tick before the sound arrives | m |
| c | speed of sound | m/s |
| a_i(t) | by how much the clock of vehicle i is ahead | s |
| rho_i | drift of that clock | s/s |
| n | normal with the standard deviation `noise` | m |
| o | outlier: exponential with the mean `excess`, with the probability `outliers`, otherwise 0 | m |
| T | from the arrival of a request to the start of the reply | s |

One-way: the packet says when it was sent, by the clock of its sender j; its receiver i takes the time of arrival.

    r = d + c (a_i(arrival) - a_j(start)) + n + o

Two-way: the receiver i of a packet sends a request to j, whose modem replies (below). Modem i measures the time
from the start of its request to the arrival of the reply, and subtracts T, which j measures.

    r = d + c (rho_i (2 d / c + T) - rho_j T) / 2 + n + o

Outliers are late, never early: sound that comes by the surface or the bottom has gone a longer way than the straight
one, which was missed. All draws are functions of (seed, sender, receiver, number of the packet); copies of a packet
have the range of the original. A range may be negative if clocks differ. Modems know `noise`, and nothing of outliers
and clocks.

| step of two-way ranging | when |
|---|---|
| a packet has come | its receiver keeps it |
| the receiver sends a request | n turns later, if it is the n-th neighbour of the sender: requests do not meet |
| the sender replies | at the first whole tick after it has the request |
| the receiver has the packet, with its range | when it has the reply |
| or without | when it has waited for as long as a reply over the modem's range can take |

Requests and replies are transmissions like any other: they take airtime, disturb and are disturbed. A modem that
transmits when one is due does not send it. Copies that a link makes of a packet are not asked for, and have no range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import log
from typing import NamedTuple

from msgspec import Struct

from netem.air import Air
from netem.config import NetemConfig
from netem.draws import normal, uniform
from netem.medium import MediumRound
from netem.modem import AcousticConfig, RangingConfig
from netem.station import REPLY, REQUEST, Reception
from netem.transit import PendingPacket
from netem.vehicle_clock import Clocks
from netem.wire.messages import MeasuredRange

NOISE, OUTLIER, EXCESS = "range noise", "range outlier", "range excess"  # purposes of draws
Ranged = list[tuple[PendingPacket, MeasuredRange | None]]  # packets for their receivers


class Query(NamedTuple):
    """A short packet that a modem sends at `start_tick`; `kind` is the `copy` of its reception."""

    start_tick: int
    src: int
    dst: int
    seq: int  # number of the packet that the query is about
    kind: int


class HeldRange(Struct, array_like=True):
    """A packet that waits for its range."""

    deadline_tick: int
    asked_tick: int
    packet: PendingPacket


class NoRanges:
    """Modems that measure no ranges, and what all modems have."""

    def __init__(self) -> None:
        self.queries: list[Query] = []  # queries that are not sent yet
        self.kept: list[HeldRange] = []

    def begin_round(self, round_: MediumRound) -> None:
        """Take the time of a round, and forget what vehicles without an agent had to send."""

    def take_packet(self, packet: PendingPacket, r: Reception) -> Ranged:
        """Take a packet that has come. Returns the packets that can be handed over now, each with its range or None."""
        return [(packet, None)]

    def take_query(self, r: Reception, end_tick: int) -> Ranged:
        """Take the reception of a query. Returns the packets that can be handed over now, as `take_packet` does."""
        return []

    def take_due(self, now: int) -> list[Query]:
        """The queries that are due at a tick; each is taken once."""
        due = sorted(query for query in self.queries if query.start_tick <= now)
        self.queries = [query for query in self.queries if query.start_tick > now]
        return due

    def give_up(self, until: int | None) -> Ranged:
        """Hand over packets without a range: those with a deadline at or before tick `until`. None: all that wait."""
        late = [kept for kept in self.kept if until is None or kept.deadline_tick <= until]
        self.kept = [] if until is None else [kept for kept in self.kept if kept.deadline_tick > until]
        return [(kept.packet, None) for kept in late]


class OneWay(NoRanges):
    """Ranges by the time of one way, of every packet."""

    def __init__(self, config: NetemConfig, acoustic: AcousticConfig, ranging: RangingConfig, air: Air) -> None:
        super().__init__()
        self._ranging = ranging
        self._acoustic = acoustic
        self._air = air
        self._seed = config.seed
        self._tick_ns, self._round_ticks = config.tick_ns, config.round_ticks
        self._tick = 0  # the round tick
        self._clocks: Clocks | None = None

    def begin_round(self, round_: MediumRound) -> None:
        self._tick, self._clocks = round_.tick, round_.clocks
        if self.queries:
            self.queries = [query for query in self.queries if query.src in (round_.positions or {})]

    def take_packet(self, packet: PendingPacket, r: Reception) -> Ranged:
        distance = self._air.range_m(r.src, r.dst)
        assert distance is not None  # both vehicles had a place when the packet was sent
        error = self._error(r.src, r.dst, r.seq)
        if self._clocks is not None:
            ahead_ns = self._ahead_ns(r.dst, r.end_ns) - self._ahead_ns(r.src, r.start_tick * self._tick_ns)
            error += self._acoustic.sound_speed * ahead_ns / 1e9
        return [(packet, MeasuredRange(distance + error, self._ranging.noise, self._tick, distance))]

    def _error(self, src: int, dst: int, seq: int) -> float:
        ranging, seed = self._ranging, self._seed
        error = ranging.noise * normal(seed, NOISE, src, dst, seq) if ranging.noise else 0.0
        if ranging.outliers and uniform(seed, OUTLIER, src, dst, seq) < ranging.outliers:
            error -= ranging.excess * log(1.0 - uniform(seed, EXCESS, src, dst, seq))
        return error

    def _ahead_ns(self, i: int, at_ns: int) -> float:
        """By how much the clock of a vehicle is ahead at a time; behind the round tick, as it goes at that tick."""
        assert self._clocks is not None
        tick = at_ns // self._tick_ns
        if tick <= self._tick:
            return self._clocks.ahead_ns(i, tick)
        # A fault that is injected later must not change what was measured before.
        since_ns = at_ns - self._tick * self._tick_ns
        return self._clocks.ahead_ns(i, self._tick) + self._clocks.drift(i, self._tick) * since_ns


class TwoWay(OneWay):
    """Ranges by the time to the sender and back."""

    def __init__(
        self,
        config: NetemConfig,
        acoustic: AcousticConfig,
        ranging: RangingConfig,
        air: Air,
        receivers: Mapping[int, Sequence[int]],
    ) -> None:
        super().__init__(config, acoustic, ranging, air)
        self._receivers = receivers

    def take_packet(self, packet: PendingPacket, r: Reception) -> Ranged:
        if packet.copy:
            return [(packet, None)]
        acoustic, tick_ns = self._acoustic, self._tick_ns
        modem, other = acoustic.modem_of(packet.dst), acoustic.modem_of(packet.src)
        turn = self._receivers[packet.src].index(packet.dst)
        asks = packet.due_tick + -(-turn * self._ranging.turn_ns // tick_ns)
        waits_ns = 2 * acoustic.delay_ns(max(modem.max_range, other.max_range))
        waits_ns += sum(m.airtime_ns(self._ranging.request) + round(m.processing * 1e9) for m in (modem, other))
        deadline = asks + -(-waits_ns // tick_ns) + 3  # three ticks more, because each start and end is at a whole tick
        self.kept.append(HeldRange(deadline, asks, packet))
        self.queries.append(Query(asks, packet.dst, packet.src, packet.seq, REQUEST))
        return []

    def take_query(self, r: Reception, end_tick: int) -> Ranged:
        modem = self._acoustic.modem_of(r.dst)
        after = max(end_tick, -(-(r.end_ns + round(modem.processing * 1e9)) // self._tick_ns))
        if r.copy == REQUEST:
            self.queries.append(Query(after, r.dst, r.src, r.seq, REPLY))
            return []
        for kept in self.kept:
            packet = kept.packet
            if (packet.src, packet.dst, packet.seq) == (r.src, r.dst, r.seq):
                self.kept.remove(kept)
                return [(self._due(packet, after), self._measured(r, kept.asked_tick))]
        return []

    def give_up(self, until: int | None) -> Ranged:
        deadlines = {kept.packet.name: kept.deadline_tick for kept in self.kept}
        return [(self._due(packet, deadlines[packet.name]), None) for packet, _ in super().give_up(until)]

    def _measured(self, reply: Reception, asked_tick: int) -> MeasuredRange:
        distance, sound_speed = reply.range_m, self._acoustic.sound_speed
        error = self._error(reply.src, reply.dst, reply.seq)
        if self._clocks is not None:
            flight_ns = distance / sound_speed * 1e9
            turnaround_ns = (reply.start_tick - asked_tick) * self._tick_ns - flight_ns
            own, other = (self._clocks.drift(i, self._tick) for i in (reply.dst, reply.src))
            error += sound_speed * (own * (2.0 * flight_ns + turnaround_ns) - other * turnaround_ns) / 2e9
        # The distance of a reception is that at the round tick before its start.
        tick = reply.start_tick // self._round_ticks * self._round_ticks
        return MeasuredRange(distance + error, self._ranging.noise, tick, distance)

    def _due(self, packet: PendingPacket, tick: int) -> PendingPacket:
        due = max(packet.due_tick, tick)
        return packet._replace(due_tick=due, delay_ns=max(packet.delay_ns, (due - packet.sent_tick) * self._tick_ns))


def make_ranges(config: NetemConfig, air: Air, receivers: Mapping[int, Sequence[int]]) -> NoRanges:
    """Make the ranges that the modems of a run measure.

    Args:
        config: of the network.
        air: the transmissions that can be heard, and the places of the vehicles.
        receivers: by sender, in the order in which they may send requests.
    """
    acoustic = config.acoustic
    if acoustic is None or acoustic.ranging is None:
        return NoRanges()
    if acoustic.ranging.method == "one-way":
        return OneWay(config, acoustic, acoustic.ranging, air)
    return TwoWay(config, acoustic, acoustic.ranging, air, receivers)
