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
from math import atan2, cos, hypot, sin, sqrt

from world.vectors import Vec3

ASTERN = 0.1  # m/s of surge, chosen: well below every speed of the runs in which no vehicle fails


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
