"""From the consensus error to a commanded speed and direction (eqs. 11, 12, 21).

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| e | consensus error | m | NED | (8) |
| K = diag(k1, k2, k3) | gain of the virtual control | 1/s | NED | (11) |
| rho | virtual control, the commanded velocity | m/s | NED | (11) |
| v_d | velocity of the reference | m/s | NED | (11) |
| u_cmd, theta_cmd, psi_cmd | commanded speed, pitch and course of the velocity | m/s, rad | NED | (12) |
"""

from __future__ import annotations

from math import atan2, hypot, sqrt

from world.vectors import Vec3


def virtual_control(e: Vec3, K: Vec3, v_d: Vec3) -> Vec3:
    """rho = -K e + v_d, eq. (11).

    Args:
        e: consensus error [m, NED].
        K: diagonal of the gain [1/s].
        v_d: velocity of the reference [m/s, NED].

    Returns:
        rho [m/s, NED].
    """
    return v_d[0] - K[0] * e[0], v_d[1] - K[1] * e[1], v_d[2] - K[2] * e[2]


def clip(vector: Vec3, low: Vec3, high: Vec3) -> Vec3:
    """Each component of `vector` moved into [low, high] of its axis."""
    x, y, z = vector
    lx, ly, lz = low
    hx, hy, hz = high
    x = lx if x < lx else min(x, hx)
    y = ly if y < ly else min(y, hy)
    z = lz if z < lz else min(z, hz)
    return x, y, z


def slew(rho: Vec3, previous: Vec3, step: float) -> Vec3:
    """rho [m/s], but at most `step` [m/s] away from `previous` on each axis."""
    px, py, pz = previous
    return clip(rho, (px - step, py - step, pz - step), (px + step, py + step, pz + step))


def direction_command(rho: Vec3, theta_held: float, psi_held: float, rho_eps: float) -> Vec3:
    """u_cmd = |rho|, theta_cmd = -atan2(rho_z, h), psi_cmd = atan2(rho_y, rho_x), h = hypot(rho_x, rho_y).

    A velocity near zero has no direction: below rho_eps the angle keeps its held value. The paper prints the
    course with arcsin, which is wrong where rho_x < 0.

    Args:
        rho: commanded velocity [m/s, NED].
        theta_held: pitch commanded at the sample before [rad].
        psi_held: course commanded at the sample before [rad].
        rho_eps: speed from which a direction counts [m/s].

    Returns:
        u_cmd [m/s], theta_cmd and psi_cmd [rad].
    """
    x, y, z = rho
    h = hypot(x, y)
    speed = sqrt(h * h + z * z)
    theta = -atan2(z, h) if speed > rho_eps else theta_held
    psi = atan2(y, x) if h > rho_eps else psi_held
    return speed, theta, psi


def floor_speed(u_cmd: float, v: float, w: float, u_floor: float) -> float:
    """u_cmd [m/s], but enough for a forward component of u_floor at the present sway and heave.

    max(u_cmd, sqrt(v^2 + w^2 + u_floor^2)). The speed law divides by the cosine between the axis and the
    velocity; a commanded speed below the sideways motion would drive that cosine to zero.

    Args:
        u_cmd: commanded speed [m/s].
        v: sway velocity [m/s, body].
        w: heave velocity [m/s, body].
        u_floor: least forward component [m/s].

    Returns:
        The commanded speed to follow [m/s].
    """
    return max(u_cmd, sqrt(v * v + w * w + u_floor * u_floor))
