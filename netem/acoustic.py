"""The acoustic channel: one payload is one broadcast, heard by all in range, and they talk in each other's way.

Pure, like `netem.network`, whose ledger, inboxes and link conditions it shares. In round k, [k, k + m):

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

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import sqrt
from typing import Any, NamedTuple

from netem.causes import COLLISION, DEAD_RECEIVER, DEAD_SENDER, HALF_DUPLEX, IN_FLIGHT, MTU, MUTE, RANGE, REPLACED, SNR
from netem.config import NetemConfig
from netem.draws import uniform
from netem.faults import ActiveFaults, active_faults
from netem.network import Exchange, Netem, Packet
from netem.propagation import decibels, power
from netem.wire.messages import Fate

Place = tuple[float, ...]  # x, y, z [m, NED]


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


@dataclass(slots=True)
class Station:
    """One vehicle's modem: what waits in it and before it, and when it talks next."""

    late: list[Waiting] = field(default_factory=list)  # of an agent that is slow
    waiting: list[Waiting] = field(default_factory=list)
    start_tick: int | None = None  # of the first that waits
    free_tick: int = 0
    seq: int = 0  # payloads that came
    draws: int = 0  # back-offs drawn

    def to_values(self) -> list[Any]:
        """Plain values."""
        late, waiting = ([list(payload) for payload in some] for some in (self.late, self.waiting))
        return [late, waiting, self.start_tick, self.free_tick, self.seq, self.draws]

    @classmethod
    def from_values(cls, values: list[Any]) -> Station:
        """The inverse of `to_values`."""
        late, waiting, *rest = values
        return cls([Waiting(*payload) for payload in late], [Waiting(*payload) for payload in waiting], *rest)


class AcousticNetem(Netem):
    """The acoustic channel of one run."""

    def __init__(self, config: NetemConfig) -> None:
        super().__init__(config)
        if config.acoustic is None or config.ideal:
            raise ValueError("an acoustic channel needs a modem, and a network that is not ideal")
        self._acoustic = config.acoustic
        self._longest = config.acoustic.longest(config.tick_ns)
        self._stations = {i: Station() for i in sorted(config.vehicles)}
        self._places: dict[int, Place] = {}
        self._air: list[Burst] = []  # whatever may still overlap a reception, by (start, src)
        self._receptions: list[Reception] = []  # that have not ended

    def exchange(
        self,
        tick: int,
        transmissions: Mapping[int, tuple[bytes, ...]],
        positions: Mapping[int, Place] | None = None,
    ) -> Exchange:
        """One round, as `Netem.exchange`; here `positions` must be known.

        Raises:
            ValueError: no positions.
        """
        if positions is None:
            raise ValueError("an acoustic channel needs the vehicles' positions")
        now, until = active_faults(self.faults, tick), tick + self.config.round_ticks
        self._places.update(positions)
        for src in sorted(transmissions):
            for payload in transmissions[src]:
                self._take(tick, src, payload, now)
        bursts = []
        for src, station in self._stations.items():
            if src in positions:
                bursts += [self._transmit(src, start, sent, now) for start, sent in self._starts(src, until, now)]
            else:
                self._fall_silent(tick, src, station)
        self._air = sorted([*self._air, *bursts])
        self._judge(until)
        fates = self._settle(tick)
        inboxes, unheard = self._announce(positions, until, now)
        self._unheard += unheard
        self._round = tick
        return Exchange(inboxes, self._book(fates))

    def close(self, end_tick: int) -> tuple[Fate, ...]:
        """The fates not yet reported when the run ends; what waits or is on the air is in flight."""
        for src, station in self._stations.items():
            for sent in (*station.late, *station.waiting):
                self._lose(src, sent, end_tick, IN_FLIGHT)
            station.late, station.waiting = [], []
        self._unheard += [_lost(r, self._due(r), IN_FLIGHT) for r in self._receptions]
        self._receptions = []
        return super().close(end_tick)

    # ---------------------------------------------------------------------------------- the modems

    def _take(self, tick: int, src: int, payload: bytes, now: ActiveFaults) -> None:
        """An agent's payload comes, and enters every link of its sender."""
        station = self._stations[src]
        sent = Waiting(tick + now.slow.get(src, 0), station.seq, tick, payload)
        station.seq += 1
        for dst in self._receivers[src]:
            self._ledger.enter((src, dst), sent=1)
        if len(payload) > self._longest:
            self._lose(src, sent, tick, MTU)
        else:
            station.late = sorted([*station.late, sent])

    def _starts(self, src: int, until: int, now: ActiveFaults) -> Iterator[tuple[int, Waiting]]:
        """What a modem puts on the air before tick `until`, with the ticks at which each starts."""
        station = self._stations[src]
        while True:
            joins = station.late[0] if station.late and station.late[0].ready_tick < until else None
            before = until if joins is None else joins.ready_tick
            while station.waiting and station.start_tick is not None and station.start_tick < before:
                start, sent = station.start_tick, station.waiting.pop(0)
                if src in now.mute:
                    self._lose(src, sent, start, MUTE)
                    station.free_tick = start + 1
                else:
                    ends_ns = start * self.config.tick_ns + self._acoustic.modem.airtime_ns(len(sent.payload))
                    station.free_tick = max(start + 1, -(-ends_ns // self.config.tick_ns))
                    yield start, sent
                station.start_tick = self._next_start(src, station.free_tick) if station.waiting else None
            if joins is None:
                return
            station.late.pop(0)
            if len(station.waiting) >= self._acoustic.buffer:
                self._lose(src, station.waiting.pop(0), joins.ready_tick, REPLACED)
            station.waiting.append(joins)
            if station.start_tick is None:
                station.start_tick = self._next_start(src, max(joins.ready_tick, station.free_tick))

    def _next_start(self, src: int, earliest: int) -> int:
        """The tick at which the MAC lets a modem talk, which it could from tick `earliest` on."""
        acoustic, station = self._acoustic, self._stations[src]
        if acoustic.mac == "aloha":
            station.draws += 1
            drawn = uniform(self.config.seed, "back-off", src, station.draws)
            return earliest + int(drawn * (acoustic.backoff_ticks + 1))
        vehicles = sorted(self.config.vehicles)
        slot, turn = acoustic.slot_ticks, len(vehicles) * acoustic.slot_ticks
        first = vehicles.index(src) * slot
        return first + max(0, -(-(earliest - first) // turn)) * turn

    def _fall_silent(self, tick: int, src: int, station: Station) -> None:
        for sent in (*station.late, *station.waiting):
            self._lose(src, sent, tick, DEAD_SENDER)
        station.late, station.waiting, station.start_tick = [], [], None

    def _lose(self, src: int, sent: Waiting, tick: int, cause: str) -> None:
        """A payload is lost on every link of its sender before it is on the air."""
        for dst in self._receivers[src]:
            self._unheard.append(Fate(tick, src, dst, sent.seq, 0, sent.sent_tick, tick, 0, cause, False, sent.payload))

    # ---------------------------------------------------------------------------------- the water

    def _transmit(self, src: int, start: int, sent: Waiting, now: ActiveFaults) -> Burst:
        """Put a payload on the air: on every link of its sender either lost at once, or to be received."""
        tick_ns, modem = self.config.tick_ns, self._acoustic.modem
        airtime = modem.airtime_ns(len(sent.payload))
        reach = {i: _range(self._places[src], place) for i, place in self._places.items() if i != src}
        for dst in self._receivers[src]:
            link = (src, dst)
            at, end = start * tick_ns, start * tick_ns + airtime
            if dst in reach:
                at, end = (t + self._acoustic.delay_ns(reach[dst]) for t in (at, end))
            whole = Reception(
                at, end, start, reach.get(dst, 0.0), 0, src, dst, sent.seq, 0, sent.sent_tick, sent.payload, False
            )
            if link in now.cut:
                self._unheard.append(_lost(whole, start, now.cut[link]))
                continue
            verdicts = self._verdicts(start * tick_ns, link, sent.seq, sent.payload, now)
            self._ledger.enter(link, duplicated=len(verdicts) - 1)
            for copy, v in enumerate(verdicts):
                one = whole._replace(copy=copy, extra_ns=v.delay_ns, payload=v.payload, corrupted=v.corrupted)
                if v.cause:
                    self._unheard.append(_lost(one, start, v.cause))
                elif dst in reach:
                    self._receptions.append(one)
                else:  # it has never had an agent, so nobody knows where it is
                    self._unheard.append(_lost(one, self._due(one), DEAD_RECEIVER))
        heard = [(i, r, self._acoustic.delay_ns(r)) for i, r in sorted(reach.items()) if r <= modem.interference_range]
        return Burst(start, src, airtime, tuple(heard))

    def _judge(self, until: int) -> None:
        """Decide on every reception that ends by tick `until`, and forget what can overlap no other."""
        ended = sorted(r for r in self._receptions if self._due(r) <= until)
        self._receptions = [r for r in self._receptions if self._due(r) > until]
        for r in ended:
            if cause := self._cause(r):
                self._unheard.append(_lost(r, self._due(r), cause))
                continue
            tick_ns, end = self.config.tick_ns, r.end_ns + r.extra_ns
            due = max(r.start_tick + 1, -(-end // tick_ns))
            delay = end - r.sent_tick * tick_ns
            packet = Packet(due, r.sent_tick, r.src, r.seq, r.copy, r.dst, delay, r.payload, r.corrupted)
            heapq.heappush(self._pending[r.dst], packet)
        horizon = min([until * self.config.tick_ns, *(r.begin_ns for r in self._receptions)])
        self._air = [burst for burst in self._air if self._last_ns(burst) > horizon]

    def _cause(self, r: Reception) -> str:
        """Why a reception fails; empty if it does not."""
        acoustic, modem = self._acoustic, self._acoustic.modem
        if r.range_m > modem.max_range:
            return RANGE
        others = 0.0
        for burst in self._air:
            begin = burst.start_tick * self.config.tick_ns
            if burst.src == r.dst:
                if begin < r.end_ns and r.begin_ns < begin + burst.airtime_ns:
                    return HALF_DUPLEX
            elif burst.src != r.src:
                for i, range_m, delay in burst.heard:
                    if i == r.dst and begin + delay < r.end_ns and r.begin_ns < begin + delay + burst.airtime_ns:
                        others += power(acoustic.received_level(range_m))
        if others and acoustic.received_level(r.range_m) - decibels(others) < modem.capture:
            return COLLISION
        lost = acoustic.packet_error_rate(r.range_m, len(r.payload))
        if lost and uniform(self.config.seed, "snr", r.src, r.dst, r.seq) < lost:
            return SNR
        return ""

    def _due(self, r: Reception) -> int:
        """The first tick not before a reception's end, whatever a link's condition adds."""
        return max(r.start_tick + 1, -(-r.end_ns // self.config.tick_ns))

    def _last_ns(self, burst: Burst) -> int:
        """When a transmission has passed everyone."""
        farthest = max((delay for _, _, delay in burst.heard), default=0)
        return burst.start_tick * self.config.tick_ns + burst.airtime_ns + farthest

    # ---------------------------------------------------------------------------------- the state

    def state(self) -> dict[str, Any]:
        """Everything that determines the rest of the run, as plain values."""
        return super().state() | {
            "stations": [[i, *station.to_values()] for i, station in self._stations.items()],
            "places": [[i, list(place)] for i, place in sorted(self._places.items())],
            "air": [[*burst[:3], [list(heard) for heard in burst.heard]] for burst in self._air],
            "receptions": [list(reception) for reception in self._receptions],
        }

    def restore(self, values: dict[str, Any]) -> None:
        """The inverse of `state`, into a core built from the same configuration."""
        super().restore(values)
        self._stations = {i: Station.from_values(station) for i, *station in values["stations"]}
        self._places = {i: tuple(place) for i, place in values["places"]}
        self._air = [
            Burst(start, src, airtime, tuple((i, r, delay) for i, r, delay in heard))
            for start, src, airtime, heard in values["air"]
        ]
        self._receptions = [Reception(*reception) for reception in values["receptions"]]


def _lost(r: Reception, tick: int, cause: str) -> Fate:
    return Fate(tick, r.src, r.dst, r.seq, r.copy, r.sent_tick, tick, 0, cause, r.corrupted, r.payload)


def _range(a: Place, b: Place) -> float:
    return sqrt(sum((x - y) * (x - y) for x, y in zip(a, b, strict=True)))
