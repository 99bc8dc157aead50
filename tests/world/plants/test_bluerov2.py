"""BlueROV2 Heavy against closed forms: allocation, terminal speeds, oscillation, stability, energy, and a current."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import cos, exp, pi, sin, sqrt, tanh

import numpy as np
import pytest

from world.api import PlantConfig, PlantState, Vec3, Vec6, Water
from world.plants import bluerov2
from world.plants.bluerov2 import ADDED, INERTIA, LINEAR, MASS, QUADRATIC, BlueROV2, G, allocation, wrench
from world.vehicle_params import VehicleParams

H = 0.005
STILL: Vec6 = (0.0,) * 6
NO_TAU: Vec3 = (0.0, 0.0, 0.0)
NEUTRAL = MASS / bluerov2.VOLUME  # density in which it neither sinks nor rises [kg/m^3]
TOTAL = np.array([MASS, MASS, MASS, *INERTIA]) + np.array(ADDED)


def rov(**parameters: float) -> BlueROV2:
    return BlueROV2(PlantConfig(1, 0.01, 1, VehicleParams(*[1.0] * 14)), **parameters)


def run(
    plant: BlueROV2,
    state: PlantState,
    seconds: float,
    tau: Vec3 = NO_TAU,
    current: Vec3 = NO_TAU,
    force: Vec6 = STILL,
    see: Callable[[PlantState], None] = lambda state: None,
    h: float = H,
) -> PlantState:
    for _ in range(round(seconds / h)):
        state = plant.step(state, tau, Water(current, force), h)
        see(state)
    return state


def by_hand() -> np.ndarray:
    """B from the places and directions of the thrusters, with cross products."""
    s = 1.0 / sqrt(2.0)
    x, y, z = bluerov2.HORIZONTAL
    a, b = bluerov2.VERTICAL
    places = [(x, y, z), (x, -y, z), (-x, y, z), (-x, -y, z), (a, b, 0), (a, -b, 0), (-a, b, 0), (-a, -b, 0)]
    ahead = [(s, -s, 0), (s, s, 0), (s, s, 0), (s, -s, 0), *[(0, 0, -1)] * 4]
    return np.array([[*axis, *np.cross(place, axis)] for place, axis in zip(places, ahead, strict=True)]).T


def test_the_wrench_is_that_of_the_geometry() -> None:
    columns = [wrench(tuple(float(i == j) for j in range(8))) for i in range(8)]
    np.testing.assert_allclose(np.array(columns).T, by_hand(), atol=1e-15)


@pytest.mark.parametrize("tau", [(10.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, -4.0), (-20.0, -2.0, 5.0)])
def test_the_allocation_is_the_pseudo_inverse(tau: Vec3) -> None:
    wanted = np.array([tau[0], 0.0, 0.0, 0.0, tau[1], tau[2]])
    np.testing.assert_allclose(allocation(*tau), np.linalg.pinv(by_hand()) @ wanted, atol=1e-13)
    np.testing.assert_allclose(wrench(allocation(*tau)), wanted, atol=1e-13)


def test_a_command_beyond_the_thrusters_keeps_its_direction() -> None:
    tau = (80.0, 10.0, 20.0)
    thrusts = allocation(*tau)
    assert max(map(abs, thrusts)) == pytest.approx(bluerov2.THRUST_MAX)
    applied = np.array(wrench(thrusts))
    np.testing.assert_allclose(applied / applied[0], np.array([80.0, 0.0, 0.0, 0.0, 10.0, 20.0]) / 80.0, atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_each_limit_is_what_the_thrusters_can_do_alone(axis: int) -> None:
    tau = [0.0, 0.0, 0.0]
    tau[axis] = BlueROV2.limits[axis]
    thrusts = allocation(tau[0], tau[1], tau[2])
    assert max(map(abs, thrusts)) == pytest.approx(bluerov2.THRUST_MAX, rel=1e-12)
    assert wrench(thrusts)[(0, 4, 5)[axis]] == pytest.approx(tau[axis], rel=1e-12)


def test_thrusters_lag_by_the_delay_that_was_identified() -> None:
    plant = rov(density=NEUTRAL)
    state = run(plant, plant.start(STILL, STILL), 0.05, (40.0, 0.0, 0.0))
    thrust = plant.report(state)["thrust"]
    assert thrust[0] == pytest.approx(allocation(40.0, 0.0, 0.0)[0] * (1.0 - exp(-0.05 / bluerov2.T_THRUSTER)))
    # The momentum of a short push is that of the thrust, however long the step; only the little drag differs.
    coarse = run(plant, plant.start(STILL, STILL), 0.05, (40.0, 0.0, 0.0), h=0.05)
    assert plant.velocity(coarse)[0] == pytest.approx(plant.velocity(state)[0], rel=1e-2)


@pytest.mark.parametrize("force", [5.0, 20.0, 40.0])
def test_surge_speeds_up_as_the_closed_form_says(force: float) -> None:
    """m u' = X - d1 u - d2 u^2 has a solution in closed form; the disturbance has no lag, so it is the force here."""
    plant = rov(density=NEUTRAL)
    d1, d2, m = LINEAR[0], QUADRATIC[0], TOTAL[0]
    root = sqrt(d1 * d1 + 4.0 * d2 * force)
    shift = np.arctanh(d1 / root)
    seconds = 0.6

    state = run(plant, plant.start(STILL, STILL), seconds, force=(force, 0.0, 0.0, 0.0, 0.0, 0.0))

    expected = (root * tanh(0.5 * root / m * seconds + shift) - d1) / (2.0 * d2)
    assert plant.velocity(state)[0] == pytest.approx(expected, rel=1e-9)
    later = run(plant, state, 8.0, force=(force, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert plant.velocity(later)[0] == pytest.approx((root - d1) / (2.0 * d2), rel=1e-9)


def test_full_thrust_gives_the_speed_that_the_thrusters_and_the_drag_say() -> None:
    """0.73 m/s; the pitch is held by hand, as so fast the hull does not hold it by itself."""
    plant = rov(density=NEUTRAL)
    state, full = plant.start(STILL, STILL), BlueROV2.limits[0]
    for _ in range(2000):
        _, _, _, _, theta, _, _, _, _, _, q, _ = state[:12]
        state = plant.step(state, (full, -20.0 * theta - 8.0 * q, 0.0), Water(NO_TAU, STILL), H)
    u = plant.velocity(state)[0]
    assert u == pytest.approx(0.734, abs=0.002)
    assert LINEAR[0] * u + QUADRATIC[0] * u * u == pytest.approx(full, rel=1e-6)


@pytest.mark.parametrize(("axis", "angle"), [("roll", 3), ("pitch", 4)])
def test_buoyancy_brings_it_upright_at_the_rate_of_a_pendulum(
    axis: str, angle: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bluerov2, "LINEAR", (0.0,) * 6)
    monkeypatch.setattr(bluerov2, "QUADRATIC", (0.0,) * 6)
    plant = rov(density=NEUTRAL)
    pose = [0.0] * 6
    pose[angle] = 0.01
    crossings: list[int] = []
    before, n = 0.01, 0

    def see(state: PlantState) -> None:
        nonlocal before, n
        n += 1
        if before * state[angle] < 0.0:
            crossings.append(n)
        before = state[angle]

    run(plant, plant.start(tuple(pose), STILL), 40.0, see=see)  # type: ignore[arg-type]

    period = 2.0 * (crossings[-1] - crossings[0]) * H / (len(crossings) - 1)
    stiffness = -bluerov2.Z_B * MASS * G
    assert period == pytest.approx(2.0 * pi * sqrt(TOTAL[angle] / stiffness), rel=1e-3), axis


def test_from_some_speed_on_it_does_not_hold_its_pitch_by_itself() -> None:
    """The Munk moment turns it across its way; heave damping and buoyancy hold against it up to a speed that the
    characteristic polynomial of heave, pitch rate and pitch gives."""

    def growth(speed: float) -> float:
        _, _, m3, _, m5, _ = TOTAL
        m1 = TOTAL[0]
        matrix = [
            [-LINEAR[2] / m3, m1 * speed / m3, 0.0],
            [(m3 - m1) * speed / m5, -LINEAR[4] / m5, bluerov2.Z_B * MASS * G / m5],
            [0.0, 1.0, 0.0],
        ]
        return float(np.linalg.eigvals(np.array(matrix)).real.max())

    plant = rov(density=NEUTRAL)

    def grown(speed: float) -> bool:
        force = (LINEAR[0] + QUADRATIC[0] * speed) * speed
        state = plant.start((0.0, 0.0, 0.0, 0.0, 1e-6, 0.0), (speed, 0.0, 0.0, 0.0, 0.0, 0.0))
        state = run(plant, state, 30.0, force=(force, 0.0, 0.0, 0.0, 0.0, 0.0))
        return abs(state[4]) > 1e-6

    critical = next(v / 100.0 for v in range(1, 100) if growth(v / 100.0) > 0.0)
    assert 0.3 < critical < 0.6
    assert not grown(critical - 0.05)
    assert grown(critical + 0.05)


def energy(state: PlantState) -> float:
    kinetic = 0.5 * float(np.sum(TOTAL * np.square(state[6:12])))
    return kinetic + bluerov2.Z_B * MASS * G * (cos(state[3]) * cos(state[4]) - 1.0)


def test_energy_only_falls_without_thrust() -> None:
    plant = rov(density=NEUTRAL)
    state = plant.start((0.0, 0.0, 5.0, 0.3, -0.4, 1.0), (0.5, -0.3, 0.2, 0.4, -0.3, 0.6))
    energies = [energy(state)]
    state = run(plant, state, 30.0, see=lambda state: energies.append(energy(state)))
    assert all(b < a for a, b in pairwise(energies))
    assert energies[-1] < 1e-3 * energies[0]


def test_without_drag_nothing_gets_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bluerov2, "LINEAR", (0.0,) * 6)
    monkeypatch.setattr(bluerov2, "QUADRATIC", (0.0,) * 6)
    plant = rov(density=NEUTRAL)
    state = plant.start((0.0, 0.0, 5.0, 0.1, -0.1, 1.0), (0.3, -0.2, 0.1, 0.2, -0.1, 0.3))
    end = run(plant, state, 5.0)
    assert energy(end) == pytest.approx(energy(state), abs=1e-8)


@pytest.mark.parametrize(("density", "sinks"), [(1000.0, True), (1025.0, False)])
def test_it_sinks_in_fresh_and_rises_in_sea_water(density: float, sinks: bool) -> None:
    plant = rov(density=density)
    state = run(plant, plant.start((0.0, 0.0, 10.0, 0.0, 0.0, 0.0), STILL), 20.0)
    w = plant.velocity(state)[2]
    heavy = (MASS - density * bluerov2.VOLUME) * G
    assert (LINEAR[2] + QUADRATIC[2] * abs(w)) * w == pytest.approx(heavy, rel=1e-9)
    assert (w > 0.0) == sinks == (plant.pose(state)[2] > 10.0)


def test_a_current_only_carries_the_motion_along() -> None:
    plant = rov()
    pose, current = (1.0, 2.0, 3.0, 0.2, -0.3, 0.8), (0.4, -0.2, 0.1)
    tau = (20.0, 1.0, -2.0)
    R = bluerov2.rotation(*pose[3:])
    carried = bluerov2.to_earth(tuple(zip(*R, strict=True)), current)  # type: ignore[arg-type]  # R' current
    still = run(plant, plant.start(pose, (0.3, 0.0, 0.0, 0.0, 0.0, 0.0)), 4.0, tau)
    moved = run(plant, plant.start(pose, (0.3 + carried[0], carried[1], carried[2], 0.0, 0.0, 0.0)), 4.0, tau, current)
    np.testing.assert_allclose(moved[3:6], still[3:6], atol=1e-7)
    np.testing.assert_allclose(np.subtract(moved[:3], still[:3]), 4.0 * np.array(current), atol=1e-7)


def test_the_step_converges_with_fourth_order() -> None:
    plant = rov()
    start = plant.start((0.0, 0.0, 5.0, 0.3, 0.4, 0.0), (0.5, 0.3, -0.2, 0.5, 0.5, -0.6))
    exact = np.array(run(plant, start, 0.8, h=0.00125))
    coarse, fine = (np.abs(np.array(run(plant, start, 0.8, h=h)) - exact).max() for h in (0.02, 0.01))
    assert coarse / fine > 10.0


def test_a_yaw_moment_turns_it_on_the_spot() -> None:
    plant = rov(density=NEUTRAL)
    state = run(plant, plant.start(STILL, STILL), 5.0, (0.0, 0.0, 6.0))
    assert plant.velocity(state)[5] == pytest.approx(sqrt(6.0 / QUADRATIC[5]), rel=1e-6)
    x, y, z, phi, theta, psi = plant.pose(state)
    assert (x, y, z, phi, theta) == pytest.approx((0.0,) * 5, abs=1e-9)
    assert psi > 2.0 * pi - 1.0  # it goes on


def test_pitching_and_going_ahead_brings_it_down() -> None:
    plant = rov(density=NEUTRAL)
    state = plant.start((0.0, 0.0, 5.0, 0.0, 0.0, 0.0), STILL)
    for _ in range(4000):
        theta, q = state[4], state[10]
        state = plant.step(state, (20.0, -10.0 * (theta + 0.3) - 6.0 * q, 0.0), Water(NO_TAU, STILL), H)
    assert plant.pose(state)[2] > 5.0 + 0.5 * plant.pose(state)[0] * sin(0.25)
    assert abs(plant.pose(state)[3]) < 1e-9


@pytest.mark.parametrize("density", [0.0, float("nan"), "heavy"])
def test_a_density_that_is_none_of_water_is_refused(density: float) -> None:
    with pytest.raises(ValueError, match="expected density as 900 to 1100 kg/m"):
        rov(density=density)
