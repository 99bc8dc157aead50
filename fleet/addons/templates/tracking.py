"""TheLaw: a tracking law for uuv-fleet. Run it with: fleet run the_law.yaml"""

from __future__ import annotations

from typing import Any

from agents.api import AgentConfig, Sample, Signal, VelocityCommand, flight_path, wrap


class TheLaw:
    """P on the speed, PD on the direction of motion."""

    # What you report at every sample. It lands in the log under uuv/<i>/control, with these units.
    signals = (
        Signal("speed_error", "m/s", "commanded minus own speed"),
        Signal("pitch_error", "rad", "commanded minus own pitch of the velocity"),
        Signal("yaw_error", "rad", "commanded minus own course"),
    )

    def __init__(self, config: AgentConfig, *, surge: float = 6.0, pitch: float = 15.0, yaw: float = 10.0) -> None:
        # What follows the star are parameters: `tracking: {law: "the_law:TheLaw", parameters: {surge: 5}}`.
        self._gains = surge, pitch, yaw
        self._inertia = config.vehicle.inertia

    def step(self, sample: Sample, command: VelocityCommand) -> tuple[tuple[float, float, float], dict[str, Any]]:
        """One control sample: surge force [N], pitch and yaw moment [N m]; and the telemetry."""
        # `command` is speed [m/s], theta and psi [rad] of the velocity that guidance asks for. Directions of motion
        # are compared, not of the hull, because these vehicles drift sideways when they turn.
        (u, v, w, q, r), (m1, m2, m3, *_) = sample.nu, self._inertia
        speed, theta, psi = flight_path(sample.eta, sample.nu)
        speed_error = command.speed - speed
        pitch_error = wrap(command.theta - theta)
        yaw_error = wrap(command.psi - psi)
        surge, pitch, yaw = self._gains
        tau = (
            command.speed + surge * speed_error,
            pitch * pitch_error - 10.0 * q - (m3 - m1) * u * w,
            yaw * yaw_error - 8.0 * r - (m1 - m2) * u * v,
        )
        return tau, {"speed_error": speed_error, "pitch_error": pitch_error, "yaw_error": yaw_error}
