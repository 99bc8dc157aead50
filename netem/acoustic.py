"""The acoustic channel: one payload is one broadcast, heard by all in range, and they talk in each other's way.

Pure, like `netem.network`, which it gives packets and losses to. In round k, [k, k + m):

1. A payload joins its modem's transmit buffer. If that is full the oldest payload waiting is `replaced`; a start that
   was already fixed stays, so that news never delays talking.
2. The MAC fixes the starts that lie in the round, at whole ticks and never before the modem is free: `aloha` a seeded
   random back-off after the payload is there and the modem is free, `tdma` the next slot of its own. What starts
   later waits.
3. Sound travels from where the sender is at round tick k to where everyone is then; a vehicle without an agent is where
   it was last known. Faults and lives are those of round tick k, too: so what happens live can be run again.
4. A reception is judged in the round in which it ends. All starts before its end are known by then, so it is
   judged against every transmission that overlaps it at the receiver. The order of transmissions is (start, src).

The causes of a loss, in the order in which they are looked for:

| cause | final at | when |
|---|---|---|
| `mtu` | round tick | longer than the modem takes, or than a slot holds |
| `replaced` | round tick | a newer payload took its place before it was sent |
| `dead sender` | round tick | its vehicle lost its agent while it waited |
| `mute`, `partition`, `down`, `loss`, `queue` | start | a fault or a link's condition, which act on top of the water |
| `range` | end of reception | the receiver is beyond the modem's range |
| `half duplex` | likewise | the receiver itself transmits during any part of it |
| `collision` | likewise | it exceeds the sum of those that overlap it, if in part, by less than `capture` |
| `snr` | likewise | lost in noise: a draw is below the packet error rate |
| `dead receiver`, `deaf` | likewise | as on every network |

A payload that ends at time t is usable at the first tick not before t, but at the earliest at the one after its start.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct

from netem.causes import Cause
from netem.config import NetemConfig
from netem.draws import uniform
from netem.faults import ActiveFaults
from netem.links import Links
from netem.medium import Place, Round
from netem.propagation import decibels, power
from netem.transit import Packet, Transit
from netem.wire.messages import Fate


class Waiting(NamedTuple):
    """A payload that is not yet on the air; `ready_tick` is when the agent hands it to the modem."""

    ready_tick: int
    seq: int
    sent_tick: int
    payload: bytes


class Burst(NamedTuple):
    """A transmission, and the vehicles that it may disturb: (vehicle, range [m], propagation [ns])."""

    start_tick: int
    src: int
    airtime_ns: int
    heard: tuple[tuple[int, float, int], ...]


class Reception(NamedTuple):
    """A transmission at one of the sender's graph neighbours; `extra_ns` is what the link's condition adds."""

    begin_ns: int
    end_ns: int
    start_tick: int
    range_m: float
    extra_ns: int
    src: int
    dst: int
    seq: int
    copy: int
    sent_tick: int
    payload: bytes
    corrupted: bool


class Station(Struct, array_like=True):
    """One vehicle's modem: what waits in it and before it, and when it talks next."""

    vehicle: int
    late: list[Waiting] = []  # of an agent that is slow
    waiting: list[Waiting] = []
    start_tick: int | None = None  # of the first that waits
    free_tick: int = 0
    seq: int = 0  # payloads that came
    draws: int = 0  # back-offs drawn


class _State(Struct):
    """What the channel adds to the state of the network."""

    stations: list[Station]
    places: list[tuple[int, Place]]
    air: list[Burst]
    receptions: list[Reception]


class AcousticChannel:
    """The acoustic channel of one run, a `netem.medium.Medium`."""

    def __init__(self, config: NetemConfig, links: Links, transit: Transit) -> None:
        if config.acoustic is None or config.ideal:
            raise ValueError("an acoustic channel needs a modem, and a network that is not ideal")
        self._config = config
        self._links = links
        self._transit = transit
        self._acoustic = config.acoustic
        self._longest = config.acoustic.longest(config.tick_ns)
        self._stations = {i: Station(i) for i in sorted(config.vehicles)}
        self._places: dict[int, Place] = {}
        self._air: list[Burst] = []  # whatever may still overlap a reception, by (start, src)
        self._receptions: list[Reception] = []  # that have not ended

    def carry(self, round_: Round) -> None:
        """Put the payloads of a round on the air, and judge the receptions that end in it.

        Raises:
            ValueError: no positions.
        """
        tick, until, transmissions, positions, faults = round_
        if positions is None:
            raise ValueError("an acoustic channel needs the vehicles' positions")
        self._places.update(positions)
        for src in sorted(transmissions):
            for payload in transmissions[src]:
                self._take(tick, src, payload, faults)
        bursts = []
        for src, station in self._stations.items():
            if src in positions:
                bursts += [self._transmit(src, start, sent, faults) for start, sent in self._starts(src, until, faults)]
            else:
                self._fall_silent(tick, src, station)
        self._air = sorted([*self._air, *bursts])
        self._judge(until)

    def close(self, end_tick: int) -> None:
        """What waits or is on the air is in flight when the run ends."""
        for src, station in self._stations.items():
            for sent in (*station.late, *station.waiting):
                self._lose(src, sent, end_tick, Cause.IN_FLIGHT)
            station.late, station.waiting = [], []
        for reception in self._receptions:
            self._transit.lose(_lost(reception, self._due(reception), Cause.IN_FLIGHT))
        self._receptions = []

    # ---------------------------------------------------------------------------------- the modems

    def _take(self, tick: int, src: int, payload: bytes, faults: ActiveFaults) -> None:
        """An agent's payload comes, and enters every link of its sender."""
        station = self._stations[src]
        sent = Waiting(tick + faults.slow.get(src, 0), station.seq, tick, payload)
        station.seq += 1
        for dst in self._links.receivers[src]:
            self._links.ledger.enter((src, dst), sent=1)
        if len(payload) > self._longest:
            self._lose(src, sent, tick, Cause.MTU)
        else:
            station.late = sorted([*station.late, sent])

    def _starts(self, src: int, until: int, faults: ActiveFaults) -> Iterator[tuple[int, Waiting]]:
        """What a modem puts on the air before tick `until`, with the ticks at which each starts."""
        station = self._stations[src]
        while True:
            joins = station.late[0] if station.late and station.late[0].ready_tick < until else None
            before = until if joins is None else joins.ready_tick
            while station.waiting and station.start_tick is not None and station.start_tick < before:
                start, sent = station.start_tick, station.waiting.pop(0)
                if src in faults.mute:
                    self._lose(src, sent, start, Cause.MUTE)
                    station.free_tick = start + 1
                else:
                    ends_ns = start * self._config.tick_ns + self._acoustic.modem.airtime_ns(len(sent.payload))
                    station.free_tick = max(start + 1, -(-ends_ns // self._config.tick_ns))
                    yield start, sent
                station.start_tick = self._next_start(src, station.free_tick) if station.waiting else None
            if joins is None:
                return
            station.late.pop(0)
            if len(station.waiting) >= self._acoustic.buffer:
                self._lose(src, station.waiting.pop(0), joins.ready_tick, Cause.REPLACED)
            station.waiting.append(joins)
            if station.start_tick is None:
                station.start_tick = self._next_start(src, max(joins.ready_tick, station.free_tick))

    def _next_start(self, src: int, earliest: int) -> int:
        """The tick at which the MAC lets a modem talk, which it could from tick `earliest` on."""
        acoustic, station = self._acoustic, self._stations[src]
        if acoustic.mac == "aloha":
            station.draws += 1
            drawn = uniform(self._config.seed, "back-off", src, station.draws)
            return earliest + int(drawn * (acoustic.backoff_ticks + 1))
        vehicles = sorted(self._config.vehicles)
        slot, turn = acoustic.slot_ticks, len(vehicles) * acoustic.slot_ticks
        first = vehicles.index(src) * slot
        return first + max(0, -(-(earliest - first) // turn)) * turn

    def _fall_silent(self, tick: int, src: int, station: Station) -> None:
        for sent in (*station.late, *station.waiting):
            self._lose(src, sent, tick, Cause.DEAD_SENDER)
        station.late, station.waiting, station.start_tick = [], [], None

    def _lose(self, src: int, sent: Waiting, tick: int, cause: Cause) -> None:
        """A payload is lost on every link of its sender before it is on the air."""
        for dst in self._links.receivers[src]:
            self._transit.lose(Fate(tick, src, dst, sent.seq, 0, sent.sent_tick, tick, 0, cause, False, sent.payload))

    # ---------------------------------------------------------------------------------- the water

    def _transmit(self, src: int, start: int, sent: Waiting, faults: ActiveFaults) -> Burst:
        """Put a payload on the air: on every link of its sender either lost at once, or to be received."""
        tick_ns, modem = self._config.tick_ns, self._acoustic.modem
        airtime = modem.airtime_ns(len(sent.payload))
        reach = {i: _range(self._places[src], place) for i, place in self._places.items() if i != src}
        for dst in self._links.receivers[src]:
            link = (src, dst)
            at, end = start * tick_ns, start * tick_ns + airtime
            if dst in reach:
                at, end = (t + self._acoustic.delay_ns(reach[dst]) for t in (at, end))
            whole = Reception(
                at, end, start, reach.get(dst, 0.0), 0, src, dst, sent.seq, 0, sent.sent_tick, sent.payload, False
            )
            if link in faults.cut:
                self._transit.lose(_lost(whole, start, faults.cut[link]))
                continue
            outcomes = self._links.enter(start * tick_ns, link, sent.seq, sent.payload, faults)
            self._links.ledger.enter(link, duplicated=len(outcomes) - 1)
            for copy, o in enumerate(outcomes):
                one = whole._replace(copy=copy, extra_ns=o.delay_ns, payload=o.payload, corrupted=o.corrupted)
                if o.cause is not None:
                    self._transit.lose(_lost(one, start, o.cause))
                elif dst in reach:
                    self._receptions.append(one)
                else:  # it has never had an agent, so its place is unknown
                    self._transit.lose(_lost(one, self._due(one), Cause.DEAD_RECEIVER))
        heard = [(i, r, self._acoustic.delay_ns(r)) for i, r in sorted(reach.items()) if r <= modem.interference_range]
        return Burst(start, src, airtime, tuple(heard))

    def _judge(self, until: int) -> None:
        """Decide on every reception that ends by tick `until`, and forget what can overlap no other."""
        ended = sorted(r for r in self._receptions if self._due(r) <= until)
        self._receptions = [r for r in self._receptions if self._due(r) > until]
        for r in ended:
            if (cause := self._cause(r)) is not None:
                self._transit.lose(_lost(r, self._due(r), cause))
                continue
            tick_ns, end = self._config.tick_ns, r.end_ns + r.extra_ns
            due = max(r.start_tick + 1, -(-end // tick_ns))
            delay = end - r.sent_tick * tick_ns
            packet = Packet(due, r.sent_tick, r.src, r.seq, r.copy, r.dst, delay, r.payload, r.corrupted)
            self._transit.add(packet)
        horizon = min([until * self._config.tick_ns, *(r.begin_ns for r in self._receptions)])
        self._air = [burst for burst in self._air if self._last_ns(burst) > horizon]

    def _cause(self, r: Reception) -> Cause | None:
        """Why a reception fails; None if it does not."""
        acoustic, modem = self._acoustic, self._acoustic.modem
        if r.range_m > modem.max_range:
            return Cause.RANGE
        others = 0.0
        for burst in self._air:
            begin = burst.start_tick * self._config.tick_ns
            if burst.src == r.dst:
                if begin < r.end_ns and r.begin_ns < begin + burst.airtime_ns:
                    return Cause.HALF_DUPLEX
            elif burst.src != r.src:
                for i, range_m, delay in burst.heard:
                    if i == r.dst and begin + delay < r.end_ns and r.begin_ns < begin + delay + burst.airtime_ns:
                        others += power(acoustic.received_level(range_m))
        if others and acoustic.received_level(r.range_m) - decibels(others) < modem.capture:
            return Cause.COLLISION
        lost = acoustic.packet_error_rate(r.range_m, len(r.payload))
        if lost and uniform(self._config.seed, "snr", r.src, r.dst, r.seq) < lost:
            return Cause.SNR
        return None

    def _due(self, r: Reception) -> int:
        """The first tick not before a reception's end, whatever a link's condition adds."""
        return max(r.start_tick + 1, -(-r.end_ns // self._config.tick_ns))

    def _last_ns(self, burst: Burst) -> int:
        """When a transmission has passed everyone."""
        farthest = max((delay for _, _, delay in burst.heard), default=0)
        return burst.start_tick * self._config.tick_ns + burst.airtime_ns + farthest

    # ---------------------------------------------------------------------------------- the state

    def state(self) -> dict[str, Any]:
        """Everything of the channel's own that determines the rest of the run, as plain values."""
        state = _State([*self._stations.values()], sorted(self._places.items()), self._air, self._receptions)
        values: dict[str, Any] = msgspec.to_builtins(state, builtin_types=(bytes,))
        return values

    def restore(self, values: dict[str, Any]) -> None:
        """The inverse of `state`."""
        state = msgspec.convert(values, _State)
        self._stations = {station.vehicle: station for station in state.stations}
        self._places = dict(state.places)
        self._air, self._receptions = state.air, state.receptions


def _lost(r: Reception, tick: int, cause: Cause) -> Fate:
    return Fate(tick, r.src, r.dst, r.seq, r.copy, r.sent_tick, tick, 0, cause, r.corrupted, r.payload)


def _range(a: Place, b: Place) -> float:
    return sqrt(sum((x - y) * (x - y) for x, y in zip(a, b, strict=True)))
