"""The consensus error of one vehicle, and the commanded speed and direction that follow from it (eqs. 8, 11, 12, 21).

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| e_i | consensus error | m | NED | (8) |
| a_ij, b_i | weight of neighbour j, weight of the own reference | 1 | - | (8) |
| Delta_ij | desired offset, p_i - p_j | m | NED | (8) |
| pd_i | desired position, eta_1^d(t) + p_i | m | NED | (11) |
| c_i = sum_j a_ij + b_i | total weight | 1 | - | (18) |
| K = diag(k1, k2, k3) | gain of the virtual control | 1/s | NED | (11) |
| rho | virtual control, the commanded velocity | m/s | NED | (11) |
| v_d | velocity of the reference | m/s | NED | (11) |
| u_cmd, theta_cmd, psi_cmd | commanded speed, pitch and course of the velocity | m/s, rad | NED | (12) |
"""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, hypot, sqrt

from agents.sample import NeighbourState
from world.vectors import Vec3


def consensus_error(position: Vec3, desired: Vec3, b: float, heard: Iterable[NeighbourState]) -> tuple[Vec3, float]:
    """e_i = sum_j a_ij (pos_i - pos_j - Delta_ij) + b_i (pos_i - pd_i) [m, NED], and c_i [1]. A neighbour that is not
    in `heard` counts in neither.
    """
    x, y, z = position
    dx, dy, dz = desired
    ex = b * (x - dx)
    ey = b * (y - dy)
    ez = b * (z - dz)
    c = b
    for _, a, (ox, oy, oz), (px, py, pz), _, _, _, _ in heard:
        ex += a * (x - px - ox)
        ey += a * (y - py - oy)
        ez += a * (z - pz - oz)
        c += a
    return (ex, ey, ez), c


def virtual_control(e: Vec3, K: Vec3, v_d: Vec3) -> Vec3:
    """rho = -K e + v_d [m/s, NED], eq. (11), with K [1/s] and e [m, NED]."""
    return v_d[0] - K[0] * e[0], v_d[1] - K[1] * e[1], v_d[2] - K[2] * e[2]


def clip(vector: Vec3, low: Vec3, high: Vec3) -> Vec3:
    """`vector` with each component limited to the range [low, high] of its axis; all in one unit."""
    x, y, z = vector
    lx, ly, lz = low
    hx, hy, hz = high
    x = lx if x < lx else min(x, hx)
    y = ly if y < ly else min(y, hy)
    z = lz if z < lz else min(z, hz)
    return x, y, z


def slew(rho: Vec3, previous: Vec3, step: float) -> Vec3:
    """rho [m/s, NED], limited on each axis to `previous` [m/s, NED] plus or minus `step` [m/s]."""
    px, py, pz = previous
    return clip(rho, (px - step, py - step, pz - step), (px + step, py + step, pz + step))


def direction_command(rho: Vec3, theta_held: float, psi_held: float, rho_eps: float) -> Vec3:
    """u_cmd = |rho| [m/s], theta_cmd = -atan2(rho_z, h), psi_cmd = atan2(rho_y, rho_x) [rad], h = hypot(rho_x, rho_y).

    A velocity near zero has no direction. If |rho| <= rho_eps [m/s], theta_cmd is theta_held, that of the previous
    sample; if h <= rho_eps, psi_cmd is psi_held. The paper computes the course with arcsin, which is wrong for rho_x <
    0.
    """
    x, y, z = rho
    h = hypot(x, y)
    speed = sqrt(h * h + z * z)
    theta = -atan2(z, h) if speed > rho_eps else theta_held
    psi = atan2(y, x) if h > rho_eps else psi_held
    return speed, theta, psi


def floor_speed(u_cmd: float, v: float, w: float, u_floor: float) -> float:
    """The commanded speed u_cmd [m/s], raised if needed so that its forward component is at least u_floor [m/s]:
    max(u_cmd, sqrt(v^2 + w^2 + u_floor^2)), with sway and heave velocity [m/s, body]. The speed law divides by the
    cosine of the angle between the vehicle's longitudinal axis and its velocity; a commanded speed below sqrt(v^2 +
    w^2) would make it zero.
    """
    return max(u_cmd, sqrt(v * v + w * w + u_floor * u_floor))
