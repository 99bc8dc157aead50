"""TheLaw: a controller for uuv-fleet. Run it with: fleet run the_law.yaml"""

from __future__ import annotations

from math import atan2, hypot
from typing import Any

from agents.api import AgentConfig, Sample, Signal, flight_path, wrap


class TheLaw:
    """Moves the vehicle towards its place: P on the position error, P on speed and direction."""

    # What you report at every sample. It lands in the log under uuv/<i>/control, with these units.
    signals = (
        Signal("distance", "m", "to the place where the vehicle should be"),
        Signal("command", "m/s", "commanded velocity, NED", 3),
    )

    def __init__(self, config: AgentConfig, *, gain: float = 0.3, speed_max: float = 1.2) -> None:
        # `config` is this agent's slice of the scenario: its number, its model of the vehicle, its neighbours, ...
        # What follows the star are parameters: `controller: {law: "the_law:TheLaw", parameters: {gain: 0.5}}`.
        self._gain = gain
        self._speed_max = speed_max
        self._inertia = config.vehicle.inertia
        self._samples = 0

    def step(self, sample: Sample) -> tuple[tuple[float, float, float], dict[str, Any]]:
        """One control sample: surge force [N], pitch and yaw moment [N m]; and the telemetry."""
        self._samples += 1
        # Where this vehicle should be now. sample.neighbours has what is known of the others, sample.e the consensus
        # error; sample.rng() is a random generator for this vehicle and tick.
        place, velocity = sample.desired
        error = [p - x for p, x in zip(place, sample.eta[:3], strict=True)]
        command = [v + self._gain * e for v, e in zip(velocity, error, strict=True)]
        speed = hypot(*command)
        shrink = min(1.0, self._speed_max / max(speed, 1e-9))
        north, east, down = (shrink * c for c in command)
        speed *= shrink

        # From the commanded velocity to forces. Directions of motion are compared, not of the hull, because these
        # vehicles drift sideways when they turn; the last terms cancel the moment that the drift causes.
        (u, v, w, q, r), (m1, m2, m3, *_) = sample.nu, self._inertia
        own_speed, theta, psi = flight_path(sample.eta, sample.nu)
        pitch_error = -theta - atan2(down, hypot(north, east))
        yaw_error = wrap(atan2(east, north) - psi)
        surge = speed + 6.0 * (speed - own_speed)
        pitch = 15.0 * pitch_error - 10.0 * q - (m3 - m1) * u * w
        yaw = 10.0 * yaw_error - 8.0 * r - (m1 - m2) * u * v
        return (surge, pitch, yaw), {"distance": hypot(*error), "command": (north, east, down)}
