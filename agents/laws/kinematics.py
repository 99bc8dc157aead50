"""Velocity in earth axes, and the direction of the flow along the body.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| eta = (x, y, z, theta, psi) | position, pitch (nose up > 0), heading | m, rad | NED | (1) |
| phi | roll, of a vehicle that has it | rad | NED | - |
| u, v, w | surge, sway, heave velocity over ground | m/s | body | (1) |
| u_a | speed | m/s | - | (3) |
| theta', psi' | attack and sideslip of the velocity in body axes | rad | body | (4) |
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, exp, hypot, pi, remainder, sin, sqrt

from world.vectors import Vec3

# --- filters: angles and their measured rates
# | symbol | meaning | unit | source |
# |---|---|---|---|
# | s_k | a sampled angle | rad | - |
# | d_k = alpha d_{k-1} + (1 - alpha) wrap(s_k - s_{k-1}) / dt, d_0 = 0 | its filtered rate | rad/s | chosen |
# | alpha = exp(-dt / tau_f) | forgetting per sample | 1 | chosen |
#
# The paper needs derivatives of commanded and of measured flow angles and does not say how to get them. The
# derivative of a noiseless model would miss the disturbance, so differences are used; they are filtered because
# every new optimal gain steps the commanded angles.


TWO_PI = 2.0 * pi
ASTERN = 0.1  # m/s of surge, chosen: well below every speed of the runs in which no vehicle fails


def wrap(angle: float) -> float:
    """The angle [rad] in (-pi, pi] that differs from `angle` by whole turns.

    Raises:
        ValueError: the angle is infinite.
    """
    if -pi < angle <= pi:
        return angle
    wrapped = remainder(angle, TWO_PI)
    return pi if wrapped <= -pi else wrapped


class RateFilter:
    """Filtered backward difference of one signal; its first sample gives 0."""

    __slots__ = ("_alpha", "_angle", "_dt", "_tau_f", "rate", "value")

    def __init__(self, tau_f: float, *, angle: bool = False) -> None:
        """Begin without a sample. `tau_f`: time constant [s]; 0 does not filter. `angle`: the signal is an angle [rad].
        Its differences are wrapped to (-pi, pi].
        """
        self._tau_f = tau_f
        self._angle = angle
        self._dt = self._alpha = 0.0
        self.value: float | None = None
        self.rate = 0.0

    def step(self, value: float, dt: float) -> float:
        """Take one sample. `dt`: time since the sample before [s]. Returns the rate [unit of the value per s]."""
        previous = self.value
        self.value = value
        if previous is None:
            return 0.0
        if dt != self._dt:
            self._dt = dt
            self._alpha = exp(-dt / self._tau_f) if self._tau_f > 0.0 else 0.0
        alpha = self._alpha
        difference = value - previous
        if self._angle and not -pi < difference <= pi:
            difference = wrap(difference)
        self.rate = rate = alpha * self.rate + (1.0 - alpha) * difference / dt
        return rate


def earth_velocity(eta: Sequence[float], nu: Sequence[float], phi: float = 0.0) -> Vec3:
    """Velocity over ground in earth axes: R(theta, psi) (u, v, w), the first three rows of eq. (1).

    Of a vehicle that rolls it is R(phi, theta, psi) (u, v, w). Without phi the answer is then wrong by at most
    `2 sin(|phi| / 2) hypot(v, w)`: 2 cm/s at 10 degrees and 0.1 m/s of sway.

    Args:
        eta: x, y, z [m, NED], theta, psi [rad].
        nu: u, v, w [m/s, body, over ground], q, r [rad/s].
        phi: roll [rad].

    Returns:
        North, east and down [m/s].
    """
    _, _, _, theta, psi = eta
    u, v, w, _, _ = nu
    if phi:
        sph = sin(phi)
        cph = cos(phi)
        v, w = cph * v - sph * w, sph * v + cph * w
    sth = sin(theta)
    cth = cos(theta)
    sps = sin(psi)
    cps = cos(psi)
    forward = cth * u + sth * w
    return cps * forward - sps * v, sps * forward + cps * v, -sth * u + cth * w


def flow_angles(u: float, v: float, w: float) -> Vec3:
    """u_a [m/s], theta' and psi' [rad] of a velocity in body axes [m/s], eqs. (3), (4).

    theta' = atan2(-w, hypot(u, v)), psi' = atan2(v, u). The paper prints arctan(v / u), which turns the direction round
    when u < 0 and has no value at u = 0.
    """
    return sqrt(u * u + v * v + w * w), atan2(-w, hypot(u, v)), atan2(v, u)


def flight_path(eta: Sequence[float], nu: Sequence[float]) -> Vec3:
    """Speed, pitch and course of a velocity, as a law should steer them.

    Astern, the pitch of the velocity falls as the bow rises: a law that steers it turns away from its depth. So below
    `ASTERN` these are the surge, which is then nearly the speed and has a sign, and the pitch and course of a vehicle
    that goes ahead at `ASTERN`.

    Args:
        eta: x, y, z [m, NED], theta, psi [rad].
        nu: u, v, w [m/s, body, over ground], q, r [rad/s].

    Returns:
        Speed [m/s], pitch [rad, up > 0] and course [rad, from north to east].
    """
    u, v, w, q, r = nu
    north, east, down = earth_velocity(eta, (max(u, ASTERN), v, w, q, r))
    return u if u < ASTERN else hypot(north, east, down), atan2(-down, hypot(north, east)), atan2(east, north)
