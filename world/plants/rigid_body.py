"""The common part of plants in six degrees of freedom: attitude, rigid body, added mass, restoring, one RK4 step.

| symbol | meaning | unit | frame |
|---|---|---|---|
| x, y, z; phi, theta, psi | position; roll, pitch (nose up > 0), heading (not wrapped), z-y-x | m; rad | NED |
| u, v, w; p, q, r | velocity over ground; rates of turn | m/s; rad/s | body |
| nu_r | the same with the velocity through the water | m/s; rad/s | body |
| m, Ix, Iy, Iz | mass; moments of inertia about the origin of the body frame | kg; kg m^2 | body |
| a11 .. a66 | added mass, diagonal and positive | kg, kg m^2 | body |
| z_g, z_b | centre of gravity and of buoyancy below the origin, both on the axis z | m | body |

Equations after T. I. Fossen, *Handbook of Marine Craft Hydrodynamics and Motion Control*, 2nd ed., Wiley 2021, chapters
2 (kinematics), 3 (rigid body), 6 (added mass, section 6.3; restoring, section 4.1). All is scalar, as in
`world/dynamics.py`, and for the same reason.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from typing import NamedTuple

from world.dynamics import NEAR_VERTICAL, turn_per_yaw
from world.vectors import Vec3, Vec6

Rotation = tuple[Vec3, Vec3, Vec3]  # the rows are north, east, down in body axes


class SixDegrees:
    """A plant whose state begins with its pose and its velocity."""

    def pose(self, state: tuple[float, ...]) -> Vec6:
        """x, y, z [m, NED], phi, theta, psi [rad]."""
        x, y, z, phi, theta, psi = state[:6]
        return x, y, z, phi, theta, psi

    def velocity(self, state: tuple[float, ...]) -> Vec6:
        """u, v, w [m/s, body, over ground], p, q, r [rad/s]."""
        u, v, w, p, q, r = state[6:12]
        return u, v, w, p, q, r


def rotation(phi: float, theta: float, psi: float) -> Rotation:
    """The matrix that turns a vector in body axes into NED, R = Rz(psi) Ry(theta) Rx(phi)."""
    sph, cph = sin(phi), cos(phi)
    sth, cth = sin(theta), cos(theta)
    sps, cps = sin(psi), cos(psi)
    return (
        (cps * cth, cps * sth * sph - sps * cph, cps * sth * cph + sps * sph),
        (sps * cth, sps * sth * sph + cps * cph, sps * sth * cph - cps * sph),
        (-sth, cth * sph, cth * cph),
    )


def to_earth(R: Rotation, body: Vec3) -> Vec3:
    """R times a vector in body axes: the same vector in NED."""
    (a, b, c), (d, e, f), (g, h, i) = R
    x, y, z = body
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def to_body(R: Rotation, earth: Vec3) -> Vec3:
    """R' times a vector in NED: the same vector in body axes."""
    (a, b, c), (d, e, f), (g, h, i) = R
    x, y, z = earth
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def euler_rates(phi: float, theta: float, p: float, q: float, r: float) -> Vec3:
    """phi', theta', psi' [rad/s] of a body that turns with p, q, r [rad/s]. Near the vertical psi' is regularised as in
    the 5-DOF model, see `world.dynamics.turn_per_yaw`: finite, and 0 at the vertical itself."""
    sph, cph = sin(phi), cos(phi)
    cth = cos(theta)
    yaw = sph * q + cph * r
    psi_dot = yaw * turn_per_yaw(cth) if -NEAR_VERTICAL < cth < NEAR_VERTICAL else yaw / cth
    return p + sin(theta) * psi_dot, cph * q - sph * r, psi_dot


class Flow(NamedTuple):
    """How a body moves through water that moves itself, all parts of it alike."""

    velocity: Vec3  # through the water [m/s, body]
    rate: Vec3  # rate of the current's components in the turning body axes, -omega x v_c [m/s^2, body]


def flow(R: Rotation, velocity: Vec3, omega: Vec3, current: Vec3) -> Flow:
    """The velocity through the water, and what turning adds to the acceleration over ground.

    Args:
        R: attitude.
        velocity: over ground [m/s, body].
        omega: p, q, r [rad/s].
        current: [m/s, NED].
    """
    if current == (0.0, 0.0, 0.0):
        return Flow(velocity, current)
    a, b, c = to_body(R, current)
    u, v, w = velocity
    p, q, r = omega
    return Flow((u - a, v - b, w - c), (r * b - q * c, p * c - r * a, q * a - p * b))


class RigidBody(NamedTuple):
    """Mass, inertia, weight and buoyancy of a body whose centres of gravity and buoyancy are on its axis z."""

    m: float
    Ix: float
    Iy: float
    Iz: float
    z_g: float
    added: Vec6
    weight: float  # [N]
    buoyancy: float  # [N]
    z_b: float = 0.0

    def coriolis(self, nu_r: Vec6) -> Vec6:
        """The forces and moments [N, N m] that turn the rigid body's momentum: C_RB(nu_r) nu_r.

        The water moves with constant velocity, so that Newton's law holds for the velocity through it as well.
        """
        m, Ix, Iy, Iz, z_g = self.m, self.Ix, self.Iy, self.Iz, self.z_g
        u, v, w, p, q, r = nu_r
        # omega x v, and omega x (omega x r_g) with r_g = (0, 0, z_g).
        x, y, z = q * w - r * v, r * u - p * w, p * v - q * u
        return (
            m * (x + z_g * p * r),
            m * (y + z_g * q * r),
            m * (z - z_g * (p * p + q * q)),
            (Iz - Iy) * q * r - m * z_g * y,
            (Ix - Iz) * r * p + m * z_g * x,
            (Iy - Ix) * p * q,
        )

    def restoring(self, phi: float, theta: float) -> Vec6:
        """The forces and moments [N, N m] that hold against weight and buoyancy: g(eta)."""
        heavy = self.weight - self.buoyancy
        moment = self.z_g * self.weight - self.z_b * self.buoyancy
        sth, cth = sin(theta), cos(theta)
        sph, cph = sin(phi), cos(phi)
        return heavy * sth, -heavy * cth * sph, -heavy * cth * cph, moment * cth * sph, moment * sth, 0.0

    def acceleration(self, force: Vec6) -> Vec6:
        """nu_r' [m/s^2, rad/s^2] under a force and moment [N, N m]: (M_RB + M_A)^-1 force.

        The centre of gravity below the origin couples surge with pitch and sway with roll; heave and yaw are alone.
        """
        a11, a22, a33, a44, a55, a66 = self.added
        X, Y, Z, K, M, N = force
        c = self.m * self.z_g
        m11, m22 = self.m + a11, self.m + a22
        m44, m55 = self.Ix + a44, self.Iy + a55
        surge_pitch = m11 * m55 - c * c
        sway_roll = m22 * m44 - c * c
        return (
            (m55 * X - c * M) / surge_pitch,
            (m44 * Y + c * K) / sway_roll,
            Z / (self.m + a33),
            (m22 * K + c * Y) / sway_roll,
            (m11 * M - c * X) / surge_pitch,
            N / (self.Iz + a66),
        )


def added_coriolis(added: Vec6, nu_r: Vec6) -> Vec6:
    """The forces and moments [N, N m] of the water that is carried along: C_A(nu_r) nu_r, the Munk moments included."""
    a11, a22, a33, a44, a55, a66 = added
    u, v, w, p, q, r = nu_r
    return (
        a33 * w * q - a22 * v * r,
        a11 * u * r - a33 * w * p,
        a22 * v * p - a11 * u * q,
        (a33 - a22) * v * w + (a66 - a55) * q * r,
        (a11 - a33) * u * w + (a44 - a66) * r * p,
        (a22 - a11) * u * v + (a55 - a44) * p * q,
    )


def rk4(
    rate: Callable[[tuple[float, ...]], tuple[float, ...]], state: tuple[float, ...], h: float
) -> tuple[float, ...]:
    """One classical Runge-Kutta step of fourth order: the state h [s] later, where `rate` is its time derivative."""
    half = 0.5 * h
    a = rate(state)
    b = rate(tuple([s + half * d for s, d in zip(state, a, strict=True)]))
    c = rate(tuple([s + half * d for s, d in zip(state, b, strict=True)]))
    e = rate(tuple([s + h * d for s, d in zip(state, c, strict=True)]))
    sixth = h / 6.0
    columns = zip(state, a, b, c, e, strict=True)
    return tuple([s + sixth * (k1 + 2.0 * (k2 + k3) + k4) for s, k1, k2, k3, k4 in columns])
