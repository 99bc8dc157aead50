"""Tracking: neurodynamics-based backstepping from a commanded speed and direction to forces (eqs. 28-47).

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| u, v, w, q, r | velocity over ground, pitch and yaw rate | m/s, rad/s | body | (1) |
| u_a | speed | m/s | - | (3) |
| theta + theta', psi + psi' | pitch and course of the velocity, as printed | rad | NED | (5) |
| theta', psi' | attack and sideslip angle | rad | body | (4) |
| u_cmd, theta_cmd, psi_cmd | commanded speed, pitch, course | m/s, rad | NED | (12) |
| q_cmd, r_cmd | commanded pitch and yaw rate | rad/s | body | (28), (29) |
| u_err .. r_err | actual minus commanded (in the paper with a tilde) | m/s, rad, rad/s | - | (24)-(29) |
| x1, x2, x3 | shunting states of u_err, q_err, r_err | m/s, rad/s | - | (43)-(47) |
| tau | surge force, pitch moment, yaw moment, before any limit | N, N m | body | (35), (45) |
| C_r | cos(theta') cos(psi'), kept away from 0 | 1 | - | (35) |

The derivatives of the commanded rates and speed are left out, as in the paper, which counts them as
disturbances; the derivatives of the angles are filtered differences (see `filters`).
"""

from __future__ import annotations

from math import cos, sin
from typing import Any

from agents.config import TrackingParams
from agents.filters import AngleRateFilter, wrap
from agents.kinematics import flow_angles
from agents.shunting import shunting_step
from agents.signals import Signal
from world.vehicle import Vec3, Vec5, VehicleParams

SIGNALS = (
    Signal("control", "u_err", "m/s", 1, "speed minus commanded speed"),
    Signal("control", "theta_err", "rad", 1, "pitch of the velocity minus the commanded one, wrapped"),
    Signal("control", "psi_err", "rad", 1, "course of the velocity minus the commanded one, wrapped"),
    Signal("control", "q_err", "rad/s", 1, "pitch rate minus commanded pitch rate"),
    Signal("control", "r_err", "rad/s", 1, "yaw rate minus commanded yaw rate"),
    Signal("control", "x", "m/s, rad/s", 3, "shunting states of u_err, q_err, r_err after the update"),
    Signal("control", "demand", "N, N m", 3, "surge force, pitch moment, yaw moment before the limits"),
)


class NeurodynamicTracking:
    """The backstepping law of one vehicle with a shunting model on each of its three error channels."""

    __slots__ = ("_filters", "_m", "_params", "_x")

    def __init__(self, params: TrackingParams, vehicle: VehicleParams) -> None:
        p = vehicle
        self._params = params
        self._m = (*p.inertia, p.beta_u, p.beta_v, p.beta_w, p.beta_q, p.beta_r, p.beta_b)
        # Rates of theta_cmd, psi_cmd, theta', psi', in this order.
        self._filters = tuple(AngleRateFilter(params.tau_f) for _ in range(4))
        self._x: Vec3 = (0.0, 0.0, 0.0)

    def step(self, eta: Vec5, nu: Vec5, command: Vec3, dt: float) -> tuple[Vec3, tuple[float, ...]]:
        """Force and moments at a sample.

        Args:
            eta: own pose; only theta and psi are used [rad].
            nu: own velocity over ground [m/s, rad/s].
            command: u_cmd [m/s], theta_cmd and psi_cmd [rad].
            dt: time since the previous sample [s].

        Returns:
            tau before the limits [N, N m], and the values of `SIGNALS`.
        """
        k = self._params
        m1, m2, m3, m4, m5, beta_u, beta_v, beta_w, beta_q, beta_r, beta_b = self._m
        _, _, _, theta, psi = eta
        u, v, w, q, r = nu
        u_cmd, theta_cmd, psi_cmd = command
        rate_theta_cmd, rate_psi_cmd, rate_attack, rate_sideslip = self._filters
        u_a, attack, sideslip = flow_angles(u, v, w)

        # Errors of speed and direction.
        u_err = u_a - u_cmd
        theta_err = wrap(theta + attack - theta_cmd)
        psi_err = wrap(psi + sideslip - psi_cmd)

        # Commanded rates of turn.
        cth = cos(theta)
        q_cmd = -k.k_theta * theta_err - rate_attack.step(attack, dt) + rate_theta_cmd.step(theta_cmd, dt)
        r_cmd = cth * (-k.k_psi * psi_err - rate_sideslip.step(sideslip, dt) + rate_psi_cmd.step(psi_cmd, dt))
        q_err = q - q_cmd
        r_err = r - r_cmd

        # The shunting states see this sample's errors before they are used: half a sample less delay, and
        # without it the loop is unstable at longer control periods.
        x1, x2, x3 = self._x
        a, b_up, b_down = k.a, k.b_up, k.b_down
        x1 = shunting_step(x1, u_err, a, b_up, b_down, dt)
        x2 = shunting_step(x2, q_err, a, b_up, b_down, dt)
        x3 = shunting_step(x3, r_err, a, b_up, b_down, dt)
        self._x = (x1, x2, x3)

        # Surge: thrust acts along the axis, so the speed along the velocity gains by its cosine.
        g = max(u_a, k.u_eps)
        C = u / g
        if -k.cos_eps < C < k.cos_eps:
            C = k.cos_eps if C >= 0.0 else -k.cos_eps
        tau1_star = v / g / m2 * (m1 * u * r + beta_v * v) - w / g / m3 * (m1 * u * q - beta_w * w)
        tau1 = -m2 * v * r + m3 * w * q + beta_u * u + m1 / C * (tau1_star - k.k_u * x1)
        tau2 = -(m3 - m1) * u * w + beta_q * q + beta_b * sin(theta) - m4 * theta_err - m4 * k.k_q * x2
        tau3 = -(m1 - m2) * u * v + beta_r * r - m5 * psi_err / max(cth, k.cos_eps) - m5 * k.k_r * x3
        demand = (tau1, tau2, tau3)
        return demand, (u_err, theta_err, psi_err, q_err, r_err, x1, x2, x3, tau1, tau2, tau3)

    def state(self) -> dict[str, Any]:
        """Plain values of everything that the next sample depends on."""
        return {"x": list(self._x), "filters": [f.state() for f in self._filters]}

    def restore(self, values: dict[str, Any]) -> None:
        x1, x2, x3 = values["x"]
        self._x = (x1, x2, x3)
        for angle_rate, state in zip(self._filters, values["filters"], strict=True):
            angle_rate.restore(state)
