"""The acoustic channel: each payload is one broadcast to all vehicles in range; transmissions can interfere.

No clock and no I/O, like `netem.network`, which uses it. It writes packets and losses to a `Transit`. A round has
m ticks. In the round that begins at tick k, that is in the ticks k to k + m - 1:

1. A payload enters the transmit buffer of its modem. If the buffer is full, the oldest payload in it is `replaced`. A
   start tick that is already fixed does not change, so a new payload never delays a transmission.
2. The MAC (medium access control) fixes the starts in the round, at whole ticks and never before the modem is free.
   `aloha`: a seeded random back-off after the payload is in the buffer and the modem is free. `tdma`: at the start of
   the vehicle's next slot. A payload whose start is in a later round stays in the buffer.
3. All distances are between the positions at round tick k; a vehicle without an agent keeps its last known position.
   The active faults, and which vehicles have an agent, are also those at tick k. So a run with faults that a user
   injected while it was running can be repeated.
4. Whether a reception succeeds is decided in the round in which it ends. Then all transmissions that started before
   its end are known, so every transmission that overlaps it at the receiver is taken into account. Transmissions are
   in the order (start, src).

The causes of a loss, in the order in which they are checked (`final at`: when the packet's fate is final):

| cause | final at | when |
|---|---|---|
| `mtu` | round tick | the payload is longer than the modem accepts, or does not fit into a slot |
| `replaced` | round tick | a newer payload replaced it in the full buffer |
| `dead sender` | round tick | the sending vehicle lost its agent while the payload waited |
| `mute`, `partition`, `down`, `loss`, `queue` | start | a fault or the link's condition, besides the acoustic causes |
| `range` | end of reception | the receiver is beyond the modem's range |
| `half duplex` | likewise | the receiver itself transmits during a part of the reception |
| `collision` | likewise | its level is less than `capture` [dB] above the sum of all that overlap it |
| `snr` | likewise | lost in noise: a seeded random number in [0, 1) is below the packet error rate |
| `dead receiver`, `deaf` | likewise | as with independent links |

A payload whose reception ends at time t is usable from the first tick at or after t, but never before the tick after
its start tick.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import sqrt
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct

from netem.causes import Cause
from netem.config import NetemConfig
from netem.draws import undecided, uniform
from netem.faults import ActiveFaults
from netem.links import Links
from netem.medium import MediumRound, Place
from netem.modem import AcousticConfig
from netem.propagation import decibels, power
from netem.transit import PendingPacket, Transit
from netem.wire.messages import Fate

BACK_OFF, SNR = "back-off", "snr"  # purposes of draws


def draws(acoustic: AcousticConfig, ranges: Iterable[float] | None = None) -> list[str]:
    """The purposes of the draws that decide on packets; none if all seeds give the same.

    Args:
        ranges: from sender to receiver [m]; None: all up to that of the modem.
    """
    found = [BACK_OFF] if acoustic.mac == "aloha" and acoustic.backoff_ticks else []
    modem = acoustic.modem
    if ranges is None:  # the farther, the more packets are lost
        noisy = acoustic.packet_error_rate(modem.max_range, 1) > 0.0
    else:
        noisy = any(undecided(acoustic.packet_error_rate(r, 1)) for r in ranges if r <= modem.max_range)
    return [*found, SNR] if noisy else found


class Waiting(NamedTuple):
    """A payload that is not yet transmitted.

    `sent_tick` is the round tick of the payload; at `ready_tick` it enters the modem (later if the agent is slow).
    """

    ready_tick: int
    seq: int
    sent_tick: int
    payload: bytes


class Burst(NamedTuple):
    """A transmission. `heard`: vehicles within the interference range, as (vehicle, range [m], propagation [ns])."""

    start_tick: int
    src: int
    airtime_ns: int
    heard: tuple[tuple[int, float, int], ...]


class Reception(NamedTuple):
    """A transmission as one graph neighbour `dst` of the sender receives it, from `begin_ns` to `end_ns`.

    `extra_ns` is the delay that the link's condition adds after `end_ns`; `copy` is 0, or 1 and more for duplicates.
    """

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
    """The modem of one vehicle: its transmit buffer, the payloads still on their way to it, and its next start."""

    vehicle: int
    late: list[Waiting] = []  # not yet in the modem, in order of ready_tick
    waiting: list[Waiting] = []  # the transmit buffer, oldest first
    start_tick: int | None = None  # of the first payload in the buffer; None: the buffer is empty
    free_tick: int = 0  # first tick at which the modem can start again
    seq: int = 0  # number of payloads taken from the agent so far
    draws: int = 0  # number of random back-offs used so far


class _State(Struct):
    """What the channel adds to the state of the network."""

    stations: list[Station]
    places: list[tuple[int, Place]]
    air: list[Burst]
    receptions: list[Reception]


class AcousticChannel:
    """The acoustic channel of one run, a `netem.medium.Medium`.

    Raises:
        ValueError: `config` has no acoustic channel, or the network is ideal.
    """

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
        self._air: list[Burst] = []  # transmissions that may still overlap a reception, sorted by (start, src)
        self._receptions: list[Reception] = []  # those that have not ended

    def carry(self, round_: MediumRound) -> None:
        """Transmit the payloads that start in a round, and decide the receptions that end in it.

        Raises:
            ValueError: the round has no positions of the vehicles.
        """
        tick, until, transmissions, positions, faults = round_
        if positions is None:
            raise ValueError("an acoustic channel needs the vehicles' positions")
        self._places.update(positions)
        for src in sorted(transmissions):
            for payload in transmissions[src]:
                self._accept(tick, src, payload, faults)
        bursts = []
        for src, station in self._stations.items():
            if src in positions:
                bursts += [self._transmit(src, start, sent, faults) for start, sent in self._starts(src, until, faults)]
            else:
                self._drop_waiting(tick, src, station)
        self._air = sorted([*self._air, *bursts])
        self._decide_receptions(until)

    def close(self, end_tick: int) -> None:
        """End the run before tick `end_tick`: record every payload that waits or is being received as in flight."""
        for src, station in self._stations.items():
            for sent in (*station.late, *station.waiting):
                self._lose_unsent(src, sent, end_tick, Cause.IN_FLIGHT)
            station.late, station.waiting = [], []
        for reception in self._receptions:
            self._transit.lose(_lost(reception, self._end_tick(reception), Cause.IN_FLIGHT))
        self._receptions = []

    # ---------------------------------------------------------------------------------- the modems

    def _accept(self, tick: int, src: int, payload: bytes, faults: ActiveFaults) -> None:
        """Take a payload from an agent, and count it as sent on every link of the sender."""
        station = self._stations[src]
        sent = Waiting(tick + faults.slow.get(src, 0), station.seq, tick, payload)
        station.seq += 1
        for dst in self._links.receivers[src]:
            self._links.ledger.enter((src, dst), sent=1)
        if len(payload) > self._longest:
            self._lose_unsent(src, sent, tick, Cause.MTU)
        else:
            station.late = sorted([*station.late, sent])

    def _starts(self, src: int, until: int, faults: ActiveFaults) -> Iterator[tuple[int, Waiting]]:
        """The transmissions that a modem starts before tick `until`, as (start tick, payload)."""
        station = self._stations[src]
        while True:
            joins = station.late[0] if station.late and station.late[0].ready_tick < until else None
            before = until if joins is None else joins.ready_tick
            while station.waiting and station.start_tick is not None and station.start_tick < before:
                start, sent = station.start_tick, station.waiting.pop(0)
                if src in faults.mute:
                    self._lose_unsent(src, sent, start, Cause.MUTE)
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
                self._lose_unsent(src, station.waiting.pop(0), joins.ready_tick, Cause.REPLACED)
            station.waiting.append(joins)
            if station.start_tick is None:
                station.start_tick = self._next_start(src, max(joins.ready_tick, station.free_tick))

    def _next_start(self, src: int, earliest: int) -> int:
        """The start tick that the MAC gives to a modem that is ready to transmit from tick `earliest` on."""
        acoustic, station = self._acoustic, self._stations[src]
        if acoustic.mac == "aloha":
            station.draws += 1
            drawn = uniform(self._config.seed, BACK_OFF, src, station.draws)
            return earliest + int(drawn * (acoustic.backoff_ticks + 1))
        vehicles = sorted(self._config.vehicles)
        slot, turn = acoustic.slot_ticks, len(vehicles) * acoustic.slot_ticks
        first = vehicles.index(src) * slot
        return first + max(0, -(-(earliest - first) // turn)) * turn

    def _drop_waiting(self, tick: int, src: int, station: Station) -> None:
        for sent in (*station.late, *station.waiting):
            self._lose_unsent(src, sent, tick, Cause.DEAD_SENDER)
        station.late, station.waiting, station.start_tick = [], [], None

    def _lose_unsent(self, src: int, sent: Waiting, tick: int, cause: Cause) -> None:
        """Record a payload that was not transmitted as lost on every link of its sender."""
        for dst in self._links.receivers[src]:
            self._transit.lose(Fate(tick, src, dst, sent.seq, 0, sent.sent_tick, tick, 0, cause, False, sent.payload))

    # ---------------------------------------------------------------------------------- the channel

    def _transmit(self, src: int, start: int, sent: Waiting, faults: ActiveFaults) -> Burst:
        """Transmit a payload: on each link of the sender it is either lost at once or becomes a reception."""
        tick_ns, modem = self._config.tick_ns, self._acoustic.modem
        airtime = modem.airtime_ns(len(sent.payload))
        reach = {i: _distance(self._places[src], place) for i, place in self._places.items() if i != src}
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
                else:  # this vehicle has never had an agent, so its position is unknown
                    self._transit.lose(_lost(one, self._end_tick(one), Cause.DEAD_RECEIVER))
        heard = [(i, r, self._acoustic.delay_ns(r)) for i, r in sorted(reach.items()) if r <= modem.interference_range]
        return Burst(start, src, airtime, tuple(heard))

    def _decide_receptions(self, until: int) -> None:
        """Decide every reception that ends by tick `until`; delete transmissions that can overlap no other."""
        ended = sorted(r for r in self._receptions if self._end_tick(r) <= until)
        self._receptions = [r for r in self._receptions if self._end_tick(r) > until]
        for r in ended:
            if (cause := self._cause(r)) is not None:
                self._transit.lose(_lost(r, self._end_tick(r), cause))
                continue
            tick_ns, end = self._config.tick_ns, r.end_ns + r.extra_ns
            due = max(r.start_tick + 1, -(-end // tick_ns))
            delay = end - r.sent_tick * tick_ns
            packet = PendingPacket(due, r.sent_tick, r.src, r.seq, r.copy, r.dst, delay, r.payload, r.corrupted)
            self._transit.add(packet)
        horizon = min([until * self._config.tick_ns, *(r.begin_ns for r in self._receptions)])
        self._air = [burst for burst in self._air if self._last_ns(burst) > horizon]

    def _cause(self, r: Reception) -> Cause | None:
        """The cause of the loss of a reception; None: it succeeds."""
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
        if lost and uniform(self._config.seed, SNR, r.src, r.dst, r.seq) < lost:
            return Cause.SNR
        return None

    def _end_tick(self, r: Reception) -> int:
        """The first tick at or after the end of a reception, and after its start tick; `extra_ns` is not included."""
        return max(r.start_tick + 1, -(-r.end_ns // self._config.tick_ns))

    def _last_ns(self, burst: Burst) -> int:
        """The time [ns] at which a transmission has ended at the farthest vehicle that it can disturb."""
        farthest = max((delay for _, _, delay in burst.heard), default=0)
        return burst.start_tick * self._config.tick_ns + burst.airtime_ns + farthest

    # ---------------------------------------------------------------------------------- the state

    def state(self) -> dict[str, Any]:
        """The part of the channel's state that determines the rest of the run, as plain values."""
        state = _State([*self._stations.values()], sorted(self._places.items()), self._air, self._receptions)
        values: dict[str, Any] = msgspec.to_builtins(state, builtin_types=(bytes,))
        return values

    def restore(self, values: dict[str, Any]) -> None:
        """Set the state from values that `state` returned.

        Raises:
            msgspec.ValidationError: the values have another form.
        """
        state = msgspec.convert(values, _State)
        self._stations = {station.vehicle: station for station in state.stations}
        self._places = dict(state.places)
        self._air, self._receptions = state.air, state.receptions


def _lost(r: Reception, tick: int, cause: Cause) -> Fate:
    return Fate(tick, r.src, r.dst, r.seq, r.copy, r.sent_tick, tick, 0, cause, r.corrupted, r.payload)


def _distance(a: Place, b: Place) -> float:
    return sqrt(sum((x - y) * (x - y) for x, y in zip(a, b, strict=True)))
