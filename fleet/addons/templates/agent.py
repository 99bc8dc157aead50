"""TheLaw: a whole agent for uuv-fleet. Run it with: fleet run the_law.yaml"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from math import atan2, hypot
from typing import Any

from agents.api import AgentConfig, Delivery, Nav, Signal, flight_path, wrap

PAYLOAD = struct.Struct("<3f")  # what we send to our neighbours: our position, in single precision


class TheLaw:
    """Keeps its place by the reference and by the mean of its neighbours' positions; its payload is its own."""

    # What you report at every sample. It lands in the log under uuv/<i>/control, with these units.
    signals = (
        Signal("distance", "m", "to the place where the vehicle should be"),
        Signal("heard", "1", "neighbours heard at least once"),
    )

    def __init__(self, config: AgentConfig, *, gain: float = 0.3) -> None:
        # What follows the star are parameters: `agent: {law: "the_law:TheLaw", parameters: {gain: 0.5}}`.
        self._config = config
        self._gain = gain
        self._heard: dict[int, tuple[float, ...]] = {}

    def transmit(self, nav: Nav) -> list[bytes]:
        """At round ticks: what goes to every neighbour. The network may delay, lose, repeat or damage it."""
        return [PAYLOAD.pack(*nav.eta[:3])]

    def decide(self, nav: Nav, deliveries: Iterable[Delivery]) -> tuple[tuple[float, float, float], dict[str, Any]]:
        """At every tick: surge force [N], pitch and yaw moment [N m]; and the telemetry.

        `nav` has tick, eta (x, y, z [m, NED], theta, psi [rad]) and nu (u, v, w [m/s], q, r [rad/s]); each delivery
        src, sent_tick, due_tick, seq and payload.
        """
        for delivery in deliveries:
            try:
                self._heard[delivery.src] = PAYLOAD.unpack(delivery.payload)
            except struct.error:  # not ours, or damaged on the way
                continue
        config = self._config
        place, velocity = config.desired(nav.tick * config.tick_ns / 1e9)
        offsets = {n.id: n.offset.at(nav.tick * config.tick_ns / 1e9).position for n in config.neighbours}
        wanted = [place, *(tuple(p + d for p, d in zip(self._heard[j], offsets[j], strict=True)) for j in self._heard)]
        mean = [sum(axis) / len(wanted) for axis in zip(*wanted, strict=True)]
        error = [max(-2.0, min(2.0, m - x)) for m, x in zip(mean, nav.eta[:3], strict=True)]
        north, east, down = (v + self._gain * e for v, e in zip(velocity, error, strict=True))
        speed = hypot(north, east, down)
        (u, v, w, q, r), (m1, m2, m3, *_) = nav.nu, config.vehicle.inertia
        own_speed, theta, psi = flight_path(nav.eta, nav.nu)
        pitch_error = -theta - atan2(down, hypot(north, east))
        yaw_error = wrap(atan2(east, north) - psi)
        tau = (
            speed + 6.0 * (speed - own_speed),
            15.0 * pitch_error - 10.0 * q - (m3 - m1) * u * w,
            10.0 * yaw_error - 8.0 * r - (m1 - m2) * u * v,
        )
        distance = hypot(*(p - x for p, x in zip(place, nav.eta[:3], strict=True)))
        return tau, {"distance": distance, "heard": len(self._heard)}
