"""The 5-DOF vehicle: its equations of motion and their integration over one step.

| symbol | meaning | unit | frame | paper |
|---|---|---|---|---|
| eta = (x, y, z, theta, psi) | position, pitch (nose up > 0), heading (not wrapped) | m, rad | NED | (1) |
| nu = (u, v, w, q, r) | velocity over ground; pitch and yaw rate | m/s, rad/s | body | (1) |
| tau = (tau1, tau2, tau3) | surge force, pitch moment, yaw moment | N, N m | body | (2) |
| d = (d1..d5) | disturbance force and moment | N, N m | body | (2) |
| v_c | ocean current, constant and irrotational | m/s | NED | - |
| nu_c = R' v_c, nu_r = nu - nu_c | current in body axes, velocity through the water | m/s | body | - |
| m1..m5 | mass and inertia including added mass, as printed | kg, kg m^2 | body | below (2) |
| beta_u..beta_r, beta_b | linear damping, pitch restoring moment | kg/s, kg m^2/s, N m | body | (2) |

Everything is scalar: for ten numbers Python floats with `math` are faster than small numpy arrays, and a
vehicle's bits cannot depend on how many others are integrated beside it.
"""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

from world.vectors import ZERO, Vec3, Vec5
from world.vehicle_params import VehicleParams

State = tuple[float, float, float, float, float, float, float, float, float, float]

# Nearer to the vertical than this |cos(theta)| (2.9 degrees) the heading rate r / cos(theta) is regularised, see
# `turn_per_yaw`. The paper's trajectories stay above 0.35. Smaller is nearer to the equations as printed, but needs
# shorter steps: a vehicle that pitches at 2 rad/s is within the bound for 10 RK4 steps of 5 ms. Measured at 4 rad/s: at
# 0.02 a passage is wrong by 0.03 rad of heading, at 0.05 by 1e-4, and 0.1 gains nothing. A quaternion has no
# singularity, but it needs a roll rate, and the model has none.
NEAR_VERTICAL = 0.05


class Coefficients(NamedTuple):
    """The constants of eq. (2), computed once per vehicle from its `VehicleParams`."""

    m1: float
    m2: float
    m3: float
    m4: float
    m5: float
    beta_u: float
    beta_v: float
    beta_w: float
    beta_q: float
    beta_r: float
    beta_b: float


def coefficients(params: VehicleParams) -> Coefficients:
    """Eq. (2)'s constants: m1..m5 [kg, kg m^2], linear damping and pitch restoring."""
    p = params
    return Coefficients(*p.inertia, p.beta_u, p.beta_v, p.beta_w, p.beta_q, p.beta_r, p.beta_b)


def turn_per_yaw(cth: float) -> float:
    """psi' / r near the vertical, for |cth| <= NEAR_VERTICAL: (1 - (1 - s^2)^5) / (s c), s = cos(theta) / c, c =
    NEAR_VERTICAL.

    It is 1 / cos(theta) at |s| = 1, where its first four derivatives are also those of 1 / cos(theta), so that RK4
    keeps its order across the bound. Between it is odd, at most 1.53 / c in size, and 0 at the vertical: there the yaw
    rate of a vehicle that cannot roll turns no heading. Derived in docs/background/paper.md.
    """
    s = cth / NEAR_VERTICAL
    s2 = s * s
    # (1 - (1 - s2)^5) / s2 written out: no division by what may be 0.
    return s * (5.0 + s2 * (-10.0 + s2 * (10.0 + s2 * (-5.0 + s2)))) / NEAR_VERTICAL


def derivative(k: Coefficients, state: State, tau: Vec3, d: Vec5, current: Vec3 = ZERO) -> State:
    """Time derivative of (eta, nu), eqs. (1)-(2) as printed, in water that moves with `current`.

    x'     = cos(theta) cos(psi) u - sin(psi) v + sin(theta) cos(psi) w
    y'     = cos(theta) sin(psi) u + cos(psi) v + sin(theta) sin(psi) w
    z'     = -sin(theta) u + cos(theta) w,   theta' = q,   psi' = r / cos(theta)
    m1 u' = m2 v r - m3 w q - beta_u u + tau1 + d1
    m2 v' = -m1 u r - beta_v v + d2
    m3 w' = m1 u q - beta_w w + d3
    m4 q' = (m3 - m1) u w - beta_q q - beta_b sin(theta) + tau2 + d4
    m5 r' = (m1 - m2) u v - beta_r r + tau3 + d5

    Where |cos(theta)| < NEAR_VERTICAL, psi' = r turn_per_yaw(cos(theta)): finite, and 0 at the vertical itself.

    In a current the right-hand sides of the last five equations use the velocity through the water nu_r. Then u', v',
    w' gain the rate of nu_c = R' v_c in the turning body axes, -omega x nu_c with omega = (-psi' sin(theta), q, psi'
    cos(theta)). Its last element is r away from the vertical. Without that term turning in a current would need a
    force, and the law "a current only carries the whole motion along" would fail.

    `state` is (x, y, z, theta, psi, u, v, w, q, r) [m, rad, m/s, rad/s], and the answer in the same order per s;
    `tau` and `d`, the disturbance on each of the five equations, are in N and N m, `current` is v_c [m/s, NED].
    """
    m1, m2, m3, m4, m5, beta_u, beta_v, beta_w, beta_q, beta_r, beta_b = k
    _, _, _, theta, psi, u, v, w, q, r = state
    tau1, tau2, tau3 = tau
    d1, d2, d3, d4, d5 = d
    sth = sin(theta)
    cth = cos(theta)
    sps = sin(psi)
    cps = cos(psi)
    if -NEAR_VERTICAL < cth < NEAR_VERTICAL:
        psi_dot = r * turn_per_yaw(cth)
        yaw_rate = psi_dot * cth
    else:
        psi_dot = r / cth
        yaw_rate = r
    x_dot = cth * cps * u - sps * v + sth * cps * w
    y_dot = cth * sps * u + cps * v + sth * sps * w
    z_dot = -sth * u + cth * w
    cx, cy, cz = current
    if cx or cy or cz:
        u_c = cth * cps * cx + cth * sps * cy - sth * cz
        v_c = -sps * cx + cps * cy
        w_c = sth * cps * cx + sth * sps * cy + cth * cz
        p = -psi_dot * sth
        du_c = yaw_rate * v_c - q * w_c
        dv_c = p * w_c - yaw_rate * u_c
        dw_c = q * u_c - p * v_c
        u -= u_c
        v -= v_c
        w -= w_c
    else:
        du_c = dv_c = dw_c = 0.0
    return (
        x_dot,
        y_dot,
        z_dot,
        q,
        psi_dot,
        (m2 * v * r - m3 * w * q - beta_u * u + tau1 + d1) / m1 + du_c,
        (-m1 * u * r - beta_v * v + d2) / m2 + dv_c,
        (m1 * u * q - beta_w * w + d3) / m3 + dw_c,
        ((m3 - m1) * u * w - beta_q * q - beta_b * sth + tau2 + d4) / m4,
        ((m1 - m2) * u * v - beta_r * r + tau3 + d5) / m5,
    )


def rk4_step(
    k: Coefficients, state: State, tau: Vec3, d: tuple[Vec5, Vec5, Vec5], h: float, current: Vec3 = ZERO
) -> State:
    """One classical Runge-Kutta step of fourth order: the state `h` [s] later. `tau` and `current` are held over the
    step, `d` is the disturbance at its start, middle and end (the stage times); units as for `derivative`.
    """
    d_start, d_middle, d_end = d
    half = 0.5 * h
    x, y, z, th, ps, u, v, w, q, r = state
    a0, a1, a2, a3, a4, a5, a6, a7, a8, a9 = derivative(k, state, tau, d_start, current)
    # The right-hand side does not depend on the position, so the inner stages leave it where it is.
    b0, b1, b2, b3, b4, b5, b6, b7, b8, b9 = derivative(
        k,
        (
            x, y, z, th + half * a3, ps + half * a4,
            u + half * a5, v + half * a6, w + half * a7, q + half * a8, r + half * a9,
        ),
        tau, d_middle, current,
    )  # fmt: skip
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = derivative(
        k,
        (
            x, y, z, th + half * b3, ps + half * b4,
            u + half * b5, v + half * b6, w + half * b7, q + half * b8, r + half * b9,
        ),
        tau, d_middle, current,
    )  # fmt: skip
    e0, e1, e2, e3, e4, e5, e6, e7, e8, e9 = derivative(
        k,
        (
            x, y, z, th + h * c3, ps + h * c4,
            u + h * c5, v + h * c6, w + h * c7, q + h * c8, r + h * c9,
        ),
        tau, d_end, current,
    )  # fmt: skip
    s = h / 6.0
    return (
        x + s * (a0 + 2.0 * (b0 + c0) + e0),
        y + s * (a1 + 2.0 * (b1 + c1) + e1),
        z + s * (a2 + 2.0 * (b2 + c2) + e2),
        th + s * (a3 + 2.0 * (b3 + c3) + e3),
        ps + s * (a4 + 2.0 * (b4 + c4) + e4),
        u + s * (a5 + 2.0 * (b5 + c5) + e5),
        v + s * (a6 + 2.0 * (b6 + c6) + e6),
        w + s * (a7 + 2.0 * (b7 + c7) + e7),
        q + s * (a8 + 2.0 * (b8 + c8) + e8),
        r + s * (a9 + 2.0 * (b9 + c9) + e9),
    )
