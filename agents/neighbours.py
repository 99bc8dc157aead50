"""What the agent knows of its neighbours: the newest state heard from each, and where they should be now.

| symbol | meaning | unit | frame |
|---|---|---|---|
| k_j | tick at which the newest state heard from j was sampled | tick | - |
| age = (now - k_j) Ts | how old that is | s | - |
| pos_j, vel_j | position and velocity over ground in that state | m, m/s | NED |
| v_d | velocity of the reference, known to every agent | m/s | NED |
| position now | pos_j ("hold"), pos_j + vel_j age ("neighbour"), pos_j + v_d age ("reference") | m | NED |

Newest means by the sending tick: a late older message never replaces a newer one. "neighbour" has no bias but
closes a loop through the neighbour's velocity that is unstable for long delays; "reference" is stable for
every delay; "hold" is stable and lags behind a moving formation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

from agents.config import Extrapolation, Neighbour
from agents.errors import PayloadError
from agents.payload import CAUSES, StateMessage, decode
from world.vehicle import Vec3


class Delivery(Protocol):
    """One payload that the network hands to an agent."""

    @property
    def due_tick(self) -> int: ...
    @property
    def sent_tick(self) -> int: ...
    @property
    def src(self) -> int: ...
    @property
    def seq(self) -> int: ...
    @property
    def payload(self) -> bytes: ...


class Heard(NamedTuple):
    """A neighbour that has been heard: weight a_ij, offset Delta_ij [m] and where it should be now [m]."""

    weight: float
    offset: Vec3
    position: Vec3


class NeighbourTable:
    """The newest state of each in-neighbour, by its sending tick."""

    def __init__(
        self,
        neighbours: Sequence[Neighbour],
        extrapolation: Extrapolation,
        reference_velocity: Vec3,
        tick_s: float,
    ) -> None:
        # One order for the sums, whatever the order of the configuration or of arrival.
        self._neighbours = tuple(sorted(neighbours, key=lambda n: n.id))
        self._extrapolation = extrapolation
        self._reference_velocity = reference_velocity
        self._tick_s = tick_s
        self._newest: dict[int, StateMessage | None] = {n.id: None for n in self._neighbours}
        self.counters = dict.fromkeys(
            ("accepted", "duplicate", "superseded", *CAUSES, "wrong_sender", "from_future"), 0
        )

    def absorb(self, deliveries: Iterable[Delivery], now: int) -> None:
        """Take in what is due at tick `now`; whatever is not usable is counted and dropped."""
        for delivery in deliveries:
            self.counters[self._absorb(delivery, now)] += 1

    def _absorb(self, delivery: Delivery, now: int) -> str:
        try:
            message = decode(delivery.payload)
        except PayloadError as error:
            return error.cause
        # The network knows who sent a packet. A payload that says otherwise came from somewhere else.
        if message.sender != delivery.src or message.sender not in self._newest:
            return "wrong_sender"
        if message.sent_tick > now:
            return "from_future"
        newest = self._newest[message.sender]
        if newest is not None and message.sent_tick <= newest.sent_tick:
            return "duplicate" if message.sent_tick == newest.sent_tick else "superseded"
        self._newest[message.sender] = message
        return "accepted"

    def heard(self, now: int) -> list[Heard]:
        """The neighbours heard so far, extrapolated to tick `now`, by ascending number."""
        found = []
        for neighbour in self._neighbours:
            message = self._newest[neighbour.id]
            if message is None:
                continue
            position = message.position
            if self._extrapolation != "hold":
                towards = message.velocity if self._extrapolation == "neighbour" else self._reference_velocity
                age = (now - message.sent_tick) * self._tick_s
                x, y, z = position
                vx, vy, vz = towards
                position = (x + vx * age, y + vy * age, z + vz * age)
            found.append(Heard(neighbour.weight, neighbour.offset, position))
        return found

    @property
    def rejected(self) -> int:
        """Payloads refused so far: damaged, not ours, or not from whom the network says."""
        return sum(self.counters[cause] for cause in (*CAUSES, "wrong_sender", "from_future"))

    def state(self) -> dict[str, Any]:
        """Plain values of what has been heard and counted."""
        newest = [[*m[:2], *m.position, *m.velocity] for m in self._newest.values() if m is not None]
        return {"newest": newest, "counters": dict(self.counters)}

    def restore(self, values: dict[str, Any]) -> None:
        self._newest = dict.fromkeys(self._newest)
        for sender, sent_tick, x, y, z, vx, vy, vz in values["newest"]:
            self._newest[sender] = StateMessage(sender, sent_tick, (x, y, z), (vx, vy, vz))
        self.counters = dict(values["counters"])
