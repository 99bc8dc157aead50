"""A roll call: all vehicles enter the next phase together, as soon as enough of them have reached this one.

Every vehicle keeps the largest phase that it knows of each vehicle, and sends all of them. So lost, late and repeated
messages do no harm. It enters the next phase when a `quorum` of vehicles has reached its phase. If a vehicle was left
behind, or has started anew, it takes the phase of the vehicles that are ahead.

* `all`: no phase begins before every vehicle is there. If one never answers again, the others wait for ever.
* `majority`: more than half of the fleet is enough. A phase may leave the others behind.

Both are safe: no vehicle is more than one phase ahead of its quorum. If vehicles are lost for good, only the second one
is live. A fault that ends cannot show this difference. A nemesis with `mode: liveness` can.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from agents.api import AgentConfig, Delivery, FormationAgent, Nav, Signal, Telemetry, Vec3, pack
from fleet.protocols.received import is_count, valid_messages

KIND = "roll-call"
_MOST_PHASES = 1_000_000


class RollCall:
    """Keeps the formation, and counts phases with the others."""

    signals = (
        Signal("phase", "1", "the phase that it is in, from 0"),
        Signal("waiting", "s", "how long it has been in this phase, by its clock"),
        Signal("answers", "1", "vehicles that have reached its phase as far as it knows, itself included"),
        Signal("refused", "1", "messages that were damaged or made no sense"),
    )

    def __init__(
        self,
        config: AgentConfig,
        *,
        vehicles: int,
        quorum: Literal["all", "majority"] = "majority",
        phase_s: float = 1.0,
    ) -> None:
        """`vehicles`: how many there are in the fleet; their numbers are 1 to this one. `quorum`: how many must have
        reached a phase before the next one begins. `phase_s`: how long a phase lasts at least [s]."""
        if quorum not in ("all", "majority"):
            raise ValueError(f"quorum: expected all or majority, got {quorum!r:.40}")
        if not config.id <= vehicles:
            raise ValueError(f"vehicles: there is a vehicle {config.id}, and vehicles is {vehicles!r:.40}")
        self._id, self._vehicles = config.id, vehicles
        self._needed = vehicles if quorum == "all" else vehicles // 2 + 1
        self._formation = FormationAgent(config)
        self._tick_s = config.tick_ns / 1e9
        self._least = round(phase_s * 1e9 / config.tick_ns)  # ticks
        self._since = -1  # tick at which its phase began; -1: not begun
        self._phases = {self._id: 0}  # the largest phase that is known of each vehicle
        self._refused = 0

    def transmit(self, nav: Nav) -> list[bytes]:
        """The payloads to send: those of the formation, and the largest known phase of every vehicle."""
        return [*self._formation.transmit(nav), pack(KIND, sorted(self._phases.items()))]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Steer like the formation agent. Take the phases that arrive, and enter the next phase if enough answered."""
        deliveries = list(deliveries)
        tau, _ = self._formation.decide(nav, deliveries)
        messages, refused = valid_messages(KIND, deliveries, self._is_valid)
        self._refused += refused
        for _, phases in messages:
            for i, phase in phases:
                self._phases[i] = max(phase, self._phases.get(i, 0))
        if self._since < 0:
            self._since = nav.tick
        before, own = self._phases[self._id], max(self._phases.values())
        if own > before:
            self._enter(own, nav.tick)
        elif self._answers() >= self._needed and nav.tick - self._since >= self._least:
            self._enter(own + 1, nav.tick)
        return tau, {
            "phase": self._phases[self._id],
            "waiting": (nav.tick - self._since) * self._tick_s,
            "answers": self._answers(),
            "refused": self._refused,
        }

    def _enter(self, phase: int, tick: int) -> None:
        self._phases[self._id], self._since = phase, tick

    def _answers(self) -> int:
        return sum(phase >= self._phases[self._id] for phase in self._phases.values())

    def _is_valid(self, values: Any, delivery: Delivery) -> bool:
        """Whether these are phases of vehicles of this fleet."""
        return (
            isinstance(values, list)
            and len(values) <= self._vehicles
            and all(isinstance(pair, list) and len(pair) == 2 for pair in values)
            and all(is_count(i, self._vehicles) and i != 0 and is_count(phase, _MOST_PHASES) for i, phase in values)
        )
