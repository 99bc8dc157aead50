"""What plants in six degrees of freedom share: laws of mechanics that hold whatever the numbers are."""

from __future__ import annotations

from itertools import product
from math import cos, isfinite, pi, sin

import pytest

from agents.laws.kinematics import earth_velocity
from world.plants.rigid_body import RigidBody, added_coriolis, euler_rates, flow, rk4, rotation, to_body, to_earth

BODY = RigidBody(30.0, 0.2, 4.0, 3.9, 0.05, (1.0, 28.0, 31.0, 0.1, 3.0, 3.5), 300.0, 290.0, -0.01)


def energy(state: tuple[float, ...]) -> float:
    """Kinetic energy of body and water that it carries along, and potential energy of weight and buoyancy [J]."""
    _, _, z, phi, theta, _, u, v, w, p, q, r = state
    b = BODY
    a11, a22, a33, a44, a55, a66 = b.added
    at_cg = (u + b.z_g * q) ** 2 + (v - b.z_g * p) ** 2 + w * w
    below = b.m * b.z_g**2
    turning = (b.Ix - below) * p * p + (b.Iy - below) * q * q + b.Iz * r * r
    carried = a11 * u * u + a22 * v * v + a33 * w * w + a44 * p * p + a55 * q * q + a66 * r * r
    hangs = b.weight * (z + b.z_g * cos(theta) * cos(phi)) - b.buoyancy * (z + b.z_b * cos(theta) * cos(phi))
    return 0.5 * (b.m * at_cg + turning + carried) - hangs


def free(state: tuple[float, ...]) -> tuple[float, ...]:
    """The time derivative of a body in still water that nothing but weight and buoyancy acts on."""
    _, _, _, phi, theta, psi, *nu = state
    u, v, w, p, q, r = nu
    forces = zip(
        BODY.coriolis((u, v, w, p, q, r)),
        added_coriolis(BODY.added, (u, v, w, p, q, r)),
        BODY.restoring(phi, theta),
        strict=True,
    )
    X, Y, Z, K, M, N = (-a - b - c for a, b, c in forces)
    R = rotation(phi, theta, psi)
    return (*to_earth(R, (u, v, w)), *euler_rates(phi, theta, p, q, r), *BODY.acceleration((X, Y, Z, K, M, N)))


def test_a_body_that_moves_freely_keeps_its_energy() -> None:
    state = (0.0, 0.0, 5.0, 0.4, -0.3, 1.0, 1.5, -0.4, 0.3, 0.5, -0.4, 0.6)
    before = energy(state)
    for _ in range(500):
        state = rk4(free, state, 0.005)
    assert energy(state) == pytest.approx(before, abs=1e-6)
    assert abs(state[5] - 1.0) > 0.3 and state[2] != 5.0  # it did turn and rise


def test_attitude_turns_there_and_back() -> None:
    for angles in product((-0.7, 0.3), (-1.2, 0.4), (-2.0, 3.5)):
        R = rotation(*angles)
        assert to_body(R, to_earth(R, (1.0, -2.0, 3.0))) == pytest.approx((1.0, -2.0, 3.0))


def test_without_roll_it_is_the_kinematics_of_five_degrees() -> None:
    eta, nu = (0.0, 0.0, 0.0, 0.4, 2.0), (1.0, 0.2, -0.3, 0.1, 0.2)
    assert to_earth(rotation(0.0, 0.4, 2.0), nu[:3]) == pytest.approx(earth_velocity(eta, nu))
    phi_dot, theta_dot, psi_dot = euler_rates(0.0, 0.4, -0.2 * sin(0.4) / cos(0.4), 0.1, 0.2)
    assert (phi_dot, theta_dot, psi_dot) == pytest.approx((0.0, 0.1, 0.2 / cos(0.4)))


def test_the_current_turns_with_the_axes_of_a_body_that_turns() -> None:
    """The components of a constant vector in turning axes, differentiated numerically."""
    p, q, r, h = 0.3, -0.2, 0.4, 1e-6
    phi, theta, psi = 0.2, -0.3, 0.5
    current = (0.4, -0.2, 0.1)
    found = flow(rotation(phi, theta, psi), (1.0, 0.0, 0.0), (p, q, r), current)
    rates = euler_rates(phi, theta, p, q, r)
    later = rotation(phi + h * rates[0], theta + h * rates[1], psi + h * rates[2])
    now = to_body(rotation(phi, theta, psi), current)
    assert found.rate == pytest.approx(
        [(b - a) / h for a, b in zip(now, to_body(later, current), strict=True)], abs=1e-6
    )
    assert found.velocity == pytest.approx((1.0 - now[0], -now[1], -now[2]))


def test_heading_is_finite_at_the_vertical() -> None:
    assert all(map(isfinite, euler_rates(0.3, 0.5 * pi, 0.1, 0.2, 0.3)))
    assert euler_rates(0.0, 0.5 * pi, 0.0, 0.0, 1.0)[2] == pytest.approx(0.0, abs=1e-9)


def test_rk4_is_of_fourth_order() -> None:
    def error(steps: int) -> float:
        state: tuple[float, ...] = (1.0, 0.0)
        for _ in range(steps):
            state = rk4(lambda s: (s[1], -s[0]), state, 1.0 / steps)
        return abs(state[0] - cos(1.0))

    assert error(10) / error(20) == pytest.approx(16.0, rel=0.1)
