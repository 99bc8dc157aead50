"""TheLaw: a protocol for uuv-fleet. Run it with: fleet run the_law.yaml"""

from __future__ import annotations

from collections.abc import Iterable

from agents.api import AgentConfig, Delivery, FormationAgent, Nav, PayloadError, Signal, Telemetry, Vec3, pack, unpack

KIND = "the_law"  # of our messages: `unpack` refuses those of other protocols


class TheLaw:
    """Knows which vehicles are there: each passes on when it last heard of every other one, at first or second hand."""

    # What you report at every sample. It lands in the log as control.there and control.first, with these units.
    signals = (
        Signal("there", "1", "vehicles that it believes present, itself included"),
        Signal("first", "1", "lowest number of these"),
    )

    def __init__(self, config: AgentConfig, *, forget_after_s: float = 3.0) -> None:
        # `config` is this agent's slice of the scenario: config.id, config.neighbours, config.tick_ns, ...
        # What follows the star are parameters: `agent: {law: "the_law:TheLaw", parameters: {forget_after_s: 5.0}}`.
        self._config = config
        self._formation = FormationAgent(config)  # steers, so that the protocol need not; nothing if moored
        self._forget_ticks = forget_after_s * 1e9 / config.tick_ns
        self._seen: dict[int, int] = {}  # vehicle -> the newest tick at which it is known to have been there

    def transmit(self, nav: Nav) -> list[bytes]:
        """At round ticks: what goes to every neighbour. The network may delay, lose, repeat or damage it."""
        self._seen[self._config.id] = nav.tick
        return [*self._formation.transmit(nav), pack(KIND, self._seen)]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """At every tick: surge force [N], pitch and yaw moment [N m]; and what the agent reports."""
        arrived = list(deliveries)
        tau, _ = self._formation.decide(nav, arrived)
        for delivery in arrived:
            try:
                seen = unpack(KIND, delivery.payload)
            except PayloadError:  # a message of the formation, or damaged on the way
                continue
            for vehicle, tick in seen.items():
                # The newest news wins, so messages that come late or twice do no harm.
                self._seen[vehicle] = max(tick, self._seen.get(vehicle, tick))
        there = {vehicle for vehicle, tick in self._seen.items() if nav.tick - tick <= self._forget_ticks}
        there.add(self._config.id)
        return tau, {"there": len(there), "first": min(there)}
