"""The acoustic channel: each payload is one broadcast to all vehicles in range; transmissions can interfere.

The channel has no clock and no I/O. `netem.network` calls it. It writes packets and losses to a `Transit`. A round has
m ticks. In the round that begins at tick k, that is in the ticks k to k + m - 1:

1. A payload enters the transmit buffer of its modem. If the buffer is full, the oldest payload in it is `replaced`, as
   is right for states of a formation. With `refuses` the new payload is lost instead, as is right for datagrams. A
   start tick that is already fixed does not change, so a new payload never delays a transmission.
2. The MAC (medium access control) fixes the starts in the round, at whole ticks and never before the modem is free.
   `aloha`: a seeded random back-off after the payload is in the buffer and the modem is free. `csma`: the same, but if
   a modem hears a transmission at its start, it draws another back-off after the end of that transmission. `tdma`: at
   the start of the vehicle's next slot by its own clock (`netem.medium_access`). If the start is in a later round, the
   payload stays in the buffer. A payload whose program has asked for a start (`netem.endpoint`) waits beside the
   buffer, and starts at that tick, whoever's turn it is.
3. All distances are between the positions at round tick k; a vehicle without an agent keeps its last known position.
   The active faults, and which vehicles have an agent, are also those at tick k. So a run with faults that a user
   injected while it was running can be repeated.
4. The channel decides whether a reception succeeds in the round of its end. By then it knows all transmissions that
   started before that end. So it takes every transmission into account that overlaps the reception at the receiver.
   Transmissions are in the order (start, src).
5. A modem with `tries` sends a payload to one neighbour after the other. The neighbour answers at the first whole tick
   after it has the payload, unless it transmits itself. Without an answer the sender tries again, and gives up after
   `tries`. A payload that arrives twice is delivered once. Conditions of links act on each try, not on answers.

The causes of a loss, in the order of the checks. From the tick `final at` on, the packet's fate does not change.

| cause | final at | when |
|---|---|---|
| `mtu` | round tick | the payload is longer than the modem accepts, or does not fit into a slot |
| `replaced` | round tick | a newer payload replaced it in the full buffer |
| `dead sender` | round tick | the sending vehicle lost its agent while the payload waited |
| `queue` | round tick | the buffer of a modem that refuses was full; or at its start, if the modem was still sending |
| `mute`, `partition`, `down`, `loss`, `queue` | start | a fault or the link's condition, besides the acoustic causes |
| `range` | end of reception | the receiver is beyond the modem's range |
| `half duplex` | likewise | the receiver itself transmits during a part of the reception |
| `collision` | likewise | its level is less than `capture` [dB] above the sum of all that overlap it; or by a draw |
| `snr` | likewise | lost in noise: a seeded random number in [0, 1) is below the packet error rate |
| `dead receiver`, `deaf` | likewise | as with independent links |

A payload becomes usable after its reception ends at time t: at the first tick at or after t plus the modem's
`processing`, but never before the tick after its start tick. A payload that is not acknowledged has the cause of its
last try.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Mapping, Sequence

from netem.air import Air
from netem.cause import Cause
from netem.config import NetemConfig
from netem.endpoint import Level
from netem.faults import ActiveFaults
from netem.link_trace import TRY
from netem.links import Links
from netem.medium import MediumRound
from netem.medium_access import Access
from netem.modem_frame import size_on_air
from netem.ranges import Query, make_ranges
from netem.station import ANSWER, Answer, Burst, QueuedPayload, Reception, Station, Transfer
from netem.transit import PendingPacket, Transit
from netem.wire.messages import Fate


class AcousticChannel:
    """The acoustic channel of one run, a `netem.medium.Medium`. Raises ValueError: `config` has none, or is ideal."""

    def __init__(self, config: NetemConfig, links: Links, transit: Transit) -> None:
        if config.acoustic is None or config.ideal:
            raise ValueError("an acoustic channel needs a modem, and a network that is not ideal")
        self._config = config
        self._links = links
        self._transit = transit
        self._acoustic = config.acoustic
        self._longest = {i: config.acoustic.longest(config.tick_ns, i) for i in config.vehicles}
        self._stations = {i: Station(i) for i in sorted(config.vehicles)}
        # By sender. Only modems with `tries` have transfers.
        self._transfers: dict[int, Transfer] = {}
        self._answers: list[Answer] = []  # acknowledgements that are not sent yet
        self._access = Access(config, config.acoustic)
        self._air = Air(config.acoustic, config.seed, config.tick_ns)
        self._receptions: list[Reception] = []  # receptions that have not ended
        # Each transmission that has begun, with the number of its payload, and payloads (sender, number) that were lost
        # in their modem; None: nobody wants to know.
        self.begun: list[tuple[int | None, Burst]] | None = None
        self.unsent: list[tuple[int, int, Cause]] = []
        self._asks = config.acoustic.ranging is not None and config.acoustic.ranging.method == "two-way"
        self._ranges = make_ranges(config, self._air, links.receivers)

    def carry(self, round_: MediumRound) -> None:
        """Transmit the payloads that start in a round, and decide the receptions that end in it. Raises ValueError: the
        round has no positions of the vehicles."""
        tick, until, transmissions, positions, faults, clocks, starts = round_
        if positions is None:
            raise ValueError("an acoustic channel needs the vehicles' positions")
        self._air.places.update(positions)
        self._access.begin_round(tick, clocks)
        self._ranges.begin_round(round_)
        for src in sorted(transmissions):
            for payload in transmissions[src]:
                self._accept(tick, src, payload, faults, starts)
        alive = [station for src, station in self._stations.items() if src in positions]
        for src, station in self._stations.items():
            if src not in positions:
                self._drop(tick, src, station)
        self._answers = [answer for answer in self._answers if answer.src in positions]
        # The earliest event first: what a modem hears, and whether it is answered, depends on all that came before.
        while (now := self._next_event(alive, until)) is not None:
            if self._transfers or self._answers or self._asks:
                self._decide_receptions(now, faults)
                self._answer(now, faults)
            for station in alive:
                self._advance(station, now, faults)
        self._decide_receptions(until, faults)
        self._transit.hand_over(self._ranges.give_up(until))

    def close(self, end_tick: int) -> None:
        """End the run before tick `end_tick`: record every payload that waits or is being received as in flight."""
        for src, station in self._stations.items():
            for sent in station.unsent:
                self._lose_unsent(src, sent, end_tick, Cause.IN_FLIGHT)
            station.late, station.waiting, station.timed = [], [], []
        for src, transfer in self._transfers.items():
            self._lose_unsent(src, transfer.sent, end_tick, Cause.IN_FLIGHT, transfer.missing())
        for reception in self._receptions:
            if not self._acoustic.modem_of(reception.src).tries and reception.copy >= 0:
                self._transit.lose(_loss(reception, self._end_tick(reception), Cause.IN_FLIGHT))
        self._transit.hand_over(self._ranges.give_up(None))
        self._receptions, self._transfers, self._answers = [], {}, []

    def refuse(self, tick: int, src: int, payload: bytes) -> None:
        """Lose a payload before its modem has it, because too much waits there."""
        self._lose_unsent(src, self._enter(tick, src, payload, 0), tick, Cause.QUEUE)

    def next_number(self, src: int) -> int:
        """The number of the next payload of a vehicle."""
        return self._stations[src].seq

    def level(self, burst: Burst, dst: int) -> Level:
        """How strong a transmission is at a vehicle that hears it."""
        return self._air.level(burst, dst)

    def under_way(self) -> set[tuple[int, int]]:
        """The payloads without a final fate, by vehicle and number."""
        unsent = {(src, sent.seq) for src, each in self._stations.items() for sent in each.unsent} | {
            (src, transfer.sent.seq) for src, transfer in self._transfers.items()
        }
        ranged = {(kept.packet.src, kept.packet.seq) for kept in self._ranges.kept}
        return unsent | ranged | {(reception.src, reception.seq) for reception in self._receptions}

    def _accept(
        self, tick: int, src: int, payload: bytes, faults: ActiveFaults, starts: Mapping[tuple[int, int], int]
    ) -> None:
        sent = self._enter(tick, src, payload, faults.slow.get(src, 0))
        start = starts.get((src, sent.seq))
        if size_on_air(payload) > self._longest[src]:
            self._lose_unsent(src, sent, tick, Cause.MTU)
        elif start is not None:
            insort(self._stations[src].timed, (max(start, sent.ready_tick), sent))
        else:
            insort(self._stations[src].late, sent)

    def _enter(self, tick: int, src: int, payload: bytes, later: int) -> QueuedPayload:
        station = self._stations[src]
        sent = QueuedPayload(tick + later, station.seq, tick, payload)
        station.seq += 1
        for dst in self._links.receivers[src]:
            self._links.ledger.enter((src, dst), sent=1)
        return sent

    def _next_event(self, alive: list[Station], until: int) -> int | None:
        ticks = [answer.start_tick for answer in self._answers]
        ticks += [query.start_tick for query in self._ranges.queries]
        for station in alive:
            ticks += [sent.ready_tick for sent in station.late[:1]]
            ticks += [start for start, _ in station.timed[:1]]
            transfer = self._transfers.get(station.vehicle)
            if transfer is not None and station.start_tick is None:
                ticks.append(transfer.deadline_tick)
            elif station.start_tick is not None:
                ticks.append(station.start_tick)
        if self._transfers or self._asks:
            ticks += [self._end_tick(r) for r in self._receptions]
        return min((tick for tick in ticks if tick < until), default=None)

    def _advance(self, station: Station, now: int, faults: ActiveFaults) -> None:
        src = station.vehicle
        transfer = self._transfers.get(src)
        if transfer is not None and station.start_tick is None and now >= transfer.deadline_tick:
            self._failed(station, transfer, now)
        while station.timed and station.timed[0][0] <= now:
            self._start_timed(station, station.timed.pop(0)[1], now, faults)
        while station.late and station.late[0].ready_tick <= now:
            joins = station.late.pop(0)
            full = len(station.waiting) >= self._acoustic.buffer
            if full and self._acoustic.refuses:
                self._lose_unsent(src, joins, joins.ready_tick, Cause.QUEUE)
                continue
            if full:
                self._lose_unsent(src, station.waiting.pop(0), joins.ready_tick, Cause.REPLACED)
            station.waiting.append(joins)
            self._schedule(station, joins.ready_tick)
        if station.start_tick is None or station.start_tick > now:
            return
        if station.free_tick > now:  # the modem is answering another one
            station.start_tick = self._access.next_start(station, station.free_tick)
        elif self._acoustic.mac == "csma" and (idle := self._air.idle_tick(src, now)) > now:
            station.start_tick = self._access.next_start(station, idle)
        else:
            self._start(station, now, faults)

    def _schedule(self, station: Station, earliest: int) -> None:
        if station.start_tick is None and station.waiting and station.vehicle not in self._transfers:
            station.start_tick = self._access.next_start(station, max(earliest, station.free_tick))

    def _start(self, station: Station, start: int, faults: ActiveFaults) -> None:
        """Transmit the first payload of the buffer.

        If an earlier one lacks its acknowledgement, transmit that one again.
        """
        src, modem, station.start_tick = station.vehicle, self._acoustic.modem_of(station.vehicle), None
        transfer = self._transfers.get(src)
        if transfer is None:
            sent = station.waiting.pop(0)
            if modem.tries and self._links.receivers[src]:
                transfer = self._transfers[src] = Transfer(sent, list(self._links.receivers[src]))
        else:
            sent = transfer.sent
        ends_ns = self._occupy(station, start, sent)
        if transfer is not None:
            transfer.tried += 1
            transfer.deadline_tick = max(
                station.free_tick, -(-(ends_ns + round(modem.timeout * 1e9)) // self._config.tick_ns)
            )
        if src in faults.mute:
            if transfer is None:
                self._lose_unsent(src, sent, start, Cause.MUTE)
                station.free_tick = start + 1
            else:
                transfer.cause = Cause.MUTE
        else:
            self._transmit(src, start, sent, transfer, faults)
        if transfer is None:
            self._schedule(station, station.free_tick)

    def _start_timed(self, station: Station, sent: QueuedPayload, start: int, faults: ActiveFaults) -> None:
        """Transmit a payload at the tick that is asked for, or never: later it would disturb somebody else's turn."""
        if station.free_tick > start or station.vehicle in faults.mute:
            cause = Cause.QUEUE if station.free_tick > start else Cause.MUTE
            self._lose_unsent(station.vehicle, sent, start, cause)
            return
        self._occupy(station, start, sent)
        self._transmit(station.vehicle, start, sent, None, faults)

    def _occupy(self, station: Station, start: int, sent: QueuedPayload) -> int:
        """Let a modem transmit a payload from a tick on. Returns when that ends [ns]."""
        tick_ns = self._config.tick_ns
        ends_ns = start * tick_ns + self._acoustic.modem_of(station.vehicle).airtime_ns(size_on_air(sent.payload))
        station.free_tick = max(start + 1, -(-ends_ns // tick_ns))
        return ends_ns

    def _drop(self, tick: int, src: int, station: Station) -> None:
        for sent in station.unsent:
            self._lose_unsent(src, sent, tick, Cause.DEAD_SENDER)
        if (transfer := self._transfers.pop(src, None)) is not None:
            self._lose_unsent(src, transfer.sent, tick, Cause.DEAD_SENDER, transfer.missing())
        station.late, station.waiting, station.timed, station.start_tick = [], [], [], None

    def _lose_unsent(
        self, src: int, sent: QueuedPayload, tick: int, cause: Cause, receivers: Sequence[int] | None = None
    ) -> None:
        if self.begun is not None:
            self.unsent.append((src, sent.seq, cause))
        for dst in self._links.receivers[src] if receivers is None else receivers:
            self._transit.lose(Fate(tick, src, dst, sent.seq, 0, sent.sent_tick, tick, 0, cause, False, sent.payload))

    def _failed(self, station: Station, transfer: Transfer, now: int) -> None:
        """No answer has come in time: try again, or give up this neighbour."""
        if transfer.tried < self._acoustic.modem_of(station.vehicle).tries:
            station.start_tick = self._access.next_start(station, max(now, station.free_tick))
        else:
            self._finish(station, transfer, now)

    def _finish(self, station: Station, transfer: Transfer, now: int) -> None:
        """Go on with the next neighbour, or with the next payload; the first has the payload, or will not get it."""
        src, dst = station.vehicle, transfer.to.pop(0)
        if not transfer.arrived:
            self._lose_unsent(src, transfer.sent, now, transfer.cause or Cause.RANGE, [dst])
        transfer.tried, transfer.arrived, transfer.cause = 0, False, None
        if transfer.to:
            station.start_tick = self._access.next_start(station, max(now, station.free_tick))
        else:
            del self._transfers[src]
            self._schedule(station, now)

    def _answer(self, now: int, faults: ActiveFaults) -> None:
        due = [Query(*answer, ANSWER) for answer in self._answers if answer.start_tick <= now]
        self._answers = [answer for answer in self._answers if answer.start_tick > now]
        for start, src, dst, seq, kind in due + self._ranges.take_due(now):
            station = self._stations[src]
            if station.free_tick > now or src in faults.mute or src in faults.deaf:
                continue
            modem, tick_ns, ranging = self._acoustic.modem_of(src), self._config.tick_ns, self._acoustic.ranging
            size = modem.acknowledgement if kind == ANSWER or ranging is None else ranging.request
            airtime = modem.airtime_ns(size)
            station.free_tick = max(start + 1, -(-(start * tick_ns + airtime) // tick_ns))
            self._put_on_air(src, start, airtime, None)
            range_m = self._air.range_m(src, dst)
            if (src, dst) not in faults.cut and range_m is not None:
                begin = start * tick_ns + self._acoustic.delay_ns(range_m)
                self._receptions.append(
                    Reception(begin, begin + airtime, start, range_m, 0, src, dst, seq, kind, start, bytes(size), False)
                )

    def _transmit(
        self, src: int, start: int, sent: QueuedPayload, transfer: Transfer | None, faults: ActiveFaults
    ) -> None:
        tick_ns = self._config.tick_ns
        airtime = self._acoustic.modem_of(src).airtime_ns(size_on_air(sent.payload))
        number = sent.seq + (TRY * (transfer.tried - 1) if transfer is not None else 0)
        for dst in self._links.receivers[src] if transfer is None else transfer.to[:1]:
            link = (src, dst)
            range_m = self._air.range_m(src, dst)
            flight = 0 if range_m is None else self._acoustic.delay_ns(range_m)
            begin = start * tick_ns + flight
            end = begin + airtime
            whole = Reception(
                begin, end, start, range_m or 0.0, 0, src, dst, sent.seq, 0, sent.sent_tick, sent.payload, False
            )
            if transfer is not None:  # the fate of a try is known before the modem gives up
                transfer.deadline_tick = max(transfer.deadline_tick, self._end_tick(whole))
            if link in faults.cut:
                self._lose(whole, start, faults.cut[link])
                continue
            outcomes = self._links.enter(start * tick_ns, link, number, sent.payload, faults)
            if transfer is None:
                self._links.ledger.enter(link, duplicated=len(outcomes) - 1)
            else:  # a modem that acknowledges knows what it has already
                outcomes = sorted(outcomes, key=lambda o: o.cause is not None)[:1]
            for copy, o in enumerate(outcomes):
                one = whole._replace(copy=copy, extra_ns=o.delay_ns, payload=o.payload, corrupted=o.corrupted)
                if o.cause is not None:
                    self._lose(one, start, o.cause)
                elif range_m is not None:
                    self._receptions.append(one)
                else:  # this vehicle has never had an agent, so its position is unknown
                    self._lose(one, self._end_tick(one), Cause.DEAD_RECEIVER)
        self._put_on_air(src, start, airtime, sent.seq)

    def _put_on_air(self, src: int, start: int, airtime_ns: int, seq: int | None) -> None:
        burst = self._air.transmit(src, start, airtime_ns)
        if self.begun is not None:
            self.begun.append((seq, burst))

    def _decide_receptions(self, until: int, faults: ActiveFaults) -> None:
        ended = sorted(r for r in self._receptions if self._end_tick(r) <= until)
        self._receptions = [r for r in self._receptions if self._end_tick(r) > until]
        for r in ended:
            cause = self._air.cause(r)
            if r.copy == ANSWER:
                self._answered(r, cause)
            elif r.copy < 0:
                self._transit.hand_over(self._ranges.take_query(r, self._end_tick(r)) if cause is None else [])
            elif cause is not None:
                self._lose(r, self._end_tick(r), cause)
            else:
                self._receive(r)
        self._air.forget(min([until * self._config.tick_ns, *(r.begin_ns for r in self._receptions)]))

    def _receive(self, r: Reception) -> None:
        tick_ns, processing = self._config.tick_ns, round(self._acoustic.modem_of(r.dst).processing * 1e9)
        end = r.end_ns + processing + r.extra_ns
        due = max(r.start_tick + 1, -(-end // tick_ns))
        transfer = self._transfers.get(r.src)
        if transfer is not None:
            self._answers.append(
                Answer(max(self._end_tick(r), -(-(r.end_ns + processing) // tick_ns)), r.dst, r.src, r.seq)
            )
            if transfer.arrived:
                return
            transfer.arrived = True
        delay = end - r.sent_tick * tick_ns
        packet = PendingPacket(due, r.sent_tick, r.src, r.seq, r.copy, r.dst, delay, r.payload, r.corrupted)
        self._transit.hand_over(self._ranges.take_packet(packet, r))

    def _answered(self, r: Reception, cause: Cause | None) -> None:
        transfer = self._transfers.get(r.dst)
        if cause is None and transfer is not None and (r.seq, r.src) == (transfer.sent.seq, transfer.to[0]):
            station = self._stations[r.dst]
            station.start_tick = None
            self._finish(station, transfer, self._end_tick(r))

    def _lose(self, r: Reception, tick: int, cause: Cause) -> None:
        """A transmission is lost on a link; if it is acknowledged, only its sender's last try decides."""
        if (transfer := self._transfers.get(r.src)) is not None:
            transfer.cause = cause
        else:
            self._transit.lose(_loss(r, tick, cause))

    def _end_tick(self, r: Reception) -> int:
        """The first tick at or after the end of a reception, and after its start tick; `extra_ns` is not included."""
        return max(r.start_tick + 1, -(-r.end_ns // self._config.tick_ns))

    def take_over(self, before: AcousticChannel) -> None:
        """Go on with what is in the modems and in the water of another run; the channel is our own."""
        self._stations, self._receptions = before._stations, before._receptions
        self._transfers, self._answers = before._transfers, before._answers
        self._air.places, self._air.bursts = before._air.places, before._air.bursts
        self._ranges.queries, self._ranges.kept = before._ranges.queries, before._ranges.kept


def _loss(r: Reception, tick: int, cause: Cause) -> Fate:
    return Fate(tick, r.src, r.dst, r.seq, r.copy, r.sent_tick, tick, 0, cause, r.corrupted, r.payload)
