"""The agent's knowledge of its neighbours: the newest state heard from each, and where they should be now.

| symbol | meaning | unit | frame |
|---|---|---|---|
| k_j | tick at which the newest state heard from j was sampled | tick | - |
| age = (now - k_j) Ts | how old that is, by the own clock and the neighbour's; never negative | s | - |
| pos_j, vel_j | position and velocity over ground in that state | m, m/s | NED |
| eta_j^d(t) | where j should be: the reference plus j's offset, which follows from Delta_ij | m | NED |
| position now, hold | pos_j | m | NED |
| position now, neighbour | pos_j + vel_j age | m | NED |
| position now, reference | pos_j + eta_j^d(now) - eta_j^d(k_j) | m | NED |

Beyond the age cap the position stays where extrapolation left it. If the agent has not heard a neighbour for longer
than `drop_after`, it leaves this neighbour out of every sum. The neighbour counts again with its next message.

The newest state is the one with the latest sending tick. A message that arrives late never replaces a newer one.
"neighbour" has no bias. But it closes a loop through the neighbour's velocity, and with long delays the loop is
unstable. "reference" is stable for every delay. "hold" is stable and lags behind a moving formation.
"""

from __future__ import annotations

from collections.abc import Iterable

from agents.codecs import FullCodec
from agents.config import AgentConfig, Neighbour
from agents.errors import PayloadError
from agents.laws.keep_apart import Seen
from agents.payload import CAUSES, StateMessage
from agents.sample import NeighbourState
from netem.wire.messages import Delivery, Nav
from world.vectors import Vec3, minus, plus

# The clock of a neighbour may be ahead of the own one by so much, and its state then counts as new. Otherwise an agent
# would lose its neighbour as soon as clocks differ by more than a message takes.
AHEAD_S = 60.0
_NO_RANGE = (None, None)
_REFUSED = (*CAUSES, "wrong_sender", "from_future")


def own_time(nav: Nav, tick_ns: int) -> tuple[int, float, int]:
    """Tick and time [s] by a vehicle's clock, and by how many ticks a neighbour's may be ahead: 0 if all are right."""
    if nav.clock_ns is None:
        return nav.tick, nav.tick * tick_ns / 1e9, 0
    return nav.clock_ns // tick_ns, nav.clock_ns / 1e9, round(AHEAD_S / (tick_ns / 1e9))


class NeighbourTable:
    """The newest state of each in-neighbour, by its sending tick."""

    def __init__(self, config: AgentConfig, codec: FullCodec) -> None:
        """Begin with no neighbour heard; `codec` reads their payloads."""
        # One order for the sums, whatever the order of the configuration or of arrival.
        self._neighbours = tuple(sorted(config.neighbours, key=lambda n: n.id))
        self._extrapolation = config.extrapolation
        self._reference = config.reference
        self._offset = config.offset  # own: p_j = p_i - Delta_ij
        self._codec = codec
        self._tick_s = tick_s = config.tick_ns / 1e9
        # In ticks, so that neither depends on how a product of floats is rounded.
        self._age_cap = round(config.age_cap_s / tick_s) if config.age_cap_s else None
        self._drop_after = round(config.drop_after_s / tick_s) if config.drop_after_s else None
        self._newest: dict[int, StateMessage | None] = {n.id: None for n in self._neighbours}
        # Range and standard deviation that came with the newest state [m].
        self._ranges: dict[int, tuple[float, float]] = {}
        self.counters = dict.fromkeys(("accepted", "duplicate", "superseded", *_REFUSED), 0)
        self._now = 0  # tick at which `states_at` was asked last
        self.rejected = 0  # payloads that were refused so far: damaged, not ours, or not from who the network names

    def absorb(self, deliveries: Iterable[Delivery], now: int, ahead: int = 0) -> None:
        """Take the packets that are due; those that cannot be used are counted. `now` and `ahead`: see `own_time`."""
        for delivery in deliveries:
            became = self._absorb(delivery, now, ahead)
            self.counters[became] += 1
            self.rejected += became in _REFUSED

    def _absorb(self, delivery: Delivery, now: int, ahead: int) -> str:
        try:
            message = self._codec.decode(delivery.payload, now, ahead)
        except PayloadError as error:
            return error.cause
        # The network knows the sender of a packet. A payload that names another one is damaged or forged.
        if message.sender != delivery.src or message.sender not in self._newest:
            return "wrong_sender"
        if message.sent_tick > now + ahead:
            return "from_future"
        newest = self._newest[message.sender]
        if newest is not None and message.sent_tick <= newest.sent_tick:
            return "duplicate" if message.sent_tick == newest.sent_tick else "superseded"
        self._newest[message.sender] = message
        if delivery.range_m is not None and delivery.range_sd_m is not None:
            self._ranges[message.sender] = delivery.range_m, delivery.range_sd_m
        elif self._ranges:
            self._ranges.pop(message.sender, None)
        return "accepted"

    def states_at(self, now: int) -> tuple[NeighbourState, ...]:
        """The neighbours heard so far, extrapolated to tick `now`, by ascending number."""
        self._now = now
        tick_s = self._tick_s
        states = []
        for neighbour in self._neighbours:
            message = self._newest[neighbour.id]
            if message is None:
                continue
            position = message.position
            ticks = now - message.sent_tick
            if ticks < 0:  # the sender's clock is ahead
                ticks = 0
            if self._drop_after is not None and ticks > self._drop_after:
                continue
            age = ticks * tick_s
            span = age if self._age_cap is None or ticks <= self._age_cap else self._age_cap * tick_s
            if self._extrapolation == "neighbour":
                x, y, z = position
                vx, vy, vz = message.velocity
                position = (x + vx * span, y + vy * span, z + vz * span)
            elif self._extrapolation == "reference":
                position = plus(position, self._drift(neighbour, message.sent_tick * tick_s, span))
            offset = neighbour.offset
            delta = offset.at(now * tick_s).position if offset.changes else offset.start
            ranged = self._ranges.get(neighbour.id, _NO_RANGE)
            states.append(
                NeighbourState(neighbour.id, neighbour.weight, delta, position, message.velocity, age, *ranged)
            )
        return tuple(states)

    def sampled_states(self) -> list[Seen]:
        """The states that `states_at` went by last, as they were sampled, by ascending number."""
        found = []
        for message in self._newest.values():
            if message is None:
                continue
            ticks = max(0, self._now - message.sent_tick)
            if self._drop_after is None or ticks <= self._drop_after:
                found.append(Seen(message.sender, message.position, message.velocity, ticks * self._tick_s))
        return found

    def newest(self, ids: Iterable[int]) -> int | None:
        """The latest sampling tick of all states heard from these neighbours. None: no message has come."""
        sent = [message.sent_tick for i in ids if (message := self._newest.get(i)) is not None]
        return max(sent, default=None)

    def _drift(self, neighbour: Neighbour, sent: float, age: float) -> Vec3:
        """How far the desired position of a neighbour has moved [m, NED] in `age` [s] since it sent at `sent` [s]."""
        assert self._reference is not None  # a scenario that extrapolates so without it is refused
        drift = self._reference.displacement(sent, age)
        if self._offset.moving or neighbour.offset.moving:
            for way, t in ((1.0, sent + age), (-1.0, sent)):
                place = minus(self._offset.at(t).position, neighbour.offset.at(t).position)
                drift = (drift[0] + way * place[0], drift[1] + way * place[1], drift[2] + way * place[2])
        return drift
