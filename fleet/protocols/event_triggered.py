"""Formation keeping that talks only when its state has changed enough (Dimarogonas, Frazzoli, Johansson 2012).

Every neighbour extrapolates the state that it heard last. So the sender knows what they believe if that state arrived,
and says nothing as long as this is near enough to the truth. After each round, who has received what was sent believes
a position within the threshold of the measured one; between rounds, and later, nothing is promised.

| symbol | meaning | unit | frame |
|---|---|---|---|
| k_s | tick at which the own state was sent last | tick | - |
| p(k), v(k) | own measured position and velocity over ground | m, m/s | NED |
| believed(k) | p(k_s), extrapolated to k as `neighbours.extrapolate` says | m | NED |
| T | weight of the velocity | s | - |
| deviation(k) = abs(p(k) - believed(k)) + T abs(v(k) - v(k_s)) | error of what neighbours believe, weighed | m | - |

At a round tick k it sends if deviation(k) > threshold, or if it has been silent for the longest silence. The velocity
counts because neighbours steer by it, too. The state is that of the formation: 63 bytes, or 15 with `payload: compact`.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import dist, isfinite

from agents.api import AgentConfig, Delivery, FormationAgent, Motion, Nav, Signal, Telemetry, Vec3, earth_velocity


class EventTriggered:
    """Keeps the formation as the agent that ships does, and sends its state only when neighbours would be wrong."""

    signals = (
        Signal(
            "deviation",
            "m",
            "error of what neighbours believe if they heard what it sent: position + ahead_s x velocity",
        ),
        Signal("sent", "1", "states sent so far"),
        Signal("unsaid", "1", "rounds so far in which it sent nothing"),
        Signal("neighbours_heard", "1", "neighbours heard at least once"),
        Signal("payloads_rejected", "1", "payloads refused so far"),
    )

    def __init__(
        self, config: AgentConfig, threshold_m: float = 0.2, silence_s: float = 5.0, ahead_s: float = 3.0
    ) -> None:
        """`threshold_m`: up to this deviation [m] it is silent; 0: it always sends. `silence_s`: after this time [s] it
        sends in any case. `ahead_s`: weight [s] of an error of the velocity; 0: only the position counts. Raises
        ValueError: one is negative or not finite, or the silence is 0."""
        for name, value in (("threshold_m", threshold_m), ("ahead_s", ahead_s)):
            if not (isfinite(value) and value >= 0.0):
                raise ValueError(f"{name}: expected 0 or more, got {value!r}")
        if not (isfinite(silence_s) and silence_s > 0.0):
            raise ValueError(f"silence_s: expected a time above 0 s, got {silence_s!r}")
        self._formation = FormationAgent(config)
        self._config = config
        self._tick_s = config.tick_ns / 1e9
        self._threshold = threshold_m
        self._ahead_s = ahead_s
        self._silence_ticks = round(silence_s / self._tick_s)
        self._told: tuple[int, Motion] | None = None  # tick, and the state that was sent
        self._sent = 0
        self._unsaid = 0

    def transmit(self, nav: Nav) -> tuple[bytes, ...]:
        """The own state, if neighbours would believe something else or have heard nothing for long."""
        told, motion = self._told, _motion(nav)
        if (
            told is not None
            and nav.tick - told[0] < self._silence_ticks
            and self._deviation(nav.tick, motion, told) <= self._threshold
        ):
            self._unsaid += 1
            return ()
        payloads = self._formation.transmit(nav)
        if payloads:  # a state beyond the range of the compact payload is not sent
            self._told = nav.tick, motion
            self._sent += 1
        return payloads

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[Vec3, Telemetry]:
        """Forces as the formation asks, and the count of what was sent."""
        tau, known = self._formation.decide(nav, deliveries)
        return tau, {
            "deviation": 0.0 if self._told is None else self._deviation(nav.tick, _motion(nav), self._told),
            "sent": float(self._sent),
            "unsaid": float(self._unsaid),
            "neighbours_heard": known["neighbours_heard"],
            "payloads_rejected": known["payloads_rejected"],
        }

    def _deviation(self, tick: int, motion: Motion, told: tuple[int, Motion]) -> float:
        """The weighed error [m] of what neighbours believe at a tick, if they have heard what was told."""
        sent_tick, (place, velocity) = told
        age = (tick - sent_tick) * self._tick_s
        config = self._config
        if config.age_cap_s:
            age = min(age, config.age_cap_s)
        if config.extrapolation == "neighbour":
            drift = [v * age for v in velocity]
        elif config.extrapolation == "reference":
            begin = sent_tick * self._tick_s
            then, now = config.desired(begin).position, config.desired(begin + age).position
            drift = [b - a for a, b in zip(then, now, strict=True)]
        else:
            drift = [0.0, 0.0, 0.0]
        off = dist(motion.position, [p + d for p, d in zip(place, drift, strict=True)])
        return off + self._ahead_s * dist(motion.velocity, velocity)


def _motion(nav: Nav) -> Motion:
    """Own position [m, NED] and velocity over ground [m/s, NED]."""
    x, y, z, theta, psi = nav.eta
    u, v, w, q, r = nav.nu
    phi = nav.roll[0] if nav.roll else 0.0
    return Motion((x, y, z), earth_velocity((x, y, z, theta, psi), (u, v, w, q, r), phi))
