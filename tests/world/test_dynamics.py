"""The sea's laws: what the printed equations must satisfy whatever the numbers are."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise
from statistics import fmean, pstdev

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import PARAMS, TAU_MAX, world_config
from repository import GOLDEN

from world.config import NavNoise, VehicleSetup, WorldConfig
from world.disturbance import NO_FORCE, PAPER, disturbance
from world.dynamics import NEAR_VERTICAL, State, coefficients, derivative, rk4_step, turn_per_yaw
from world.errors import IntegrationError, WorldError
from world.sea import World
from world.vectors import ZERO, Vec3

K = coefficients(PARAMS)
NO_DAMPING = coefficients(replace(PARAMS, beta_u=0.0, beta_v=0.0, beta_w=0.0, beta_q=0.0, beta_r=0.0, beta_b=0.0))
REST = (0.0, 0.0, 0.0)
CALM_SEA = (NO_FORCE, NO_FORCE, NO_FORCE)

speed = st.floats(-3.0, 3.0)
pitch = st.floats(-1.2, 1.2)
course = st.floats(-7.0, 7.0)
states = st.tuples(speed, speed, speed, pitch, course, speed, speed, speed, speed, speed)
currents = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
commands = st.tuples(st.floats(-20.0, 20.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


def power(k, state: State, rate: State) -> float:
    """Rate of the kinetic energy: sum of m_n nu_n nu_n'."""
    return sum(m * n * dn for m, n, dn in zip(k[:5], state[5:], rate[5:], strict=True))


def close(a, b, tolerance: float) -> bool:
    return all(abs(x - y) <= tolerance for x, y in zip(a, b, strict=True))


def test_derivative_and_step_agree_with_an_independent_implementation() -> None:
    cases = json.loads((GOLDEN / "unit_vectors.json").read_text())["plant"]
    assert cases
    for case in cases:
        harmonics = PAPER if case["disturbed"] else ()
        state, tau, t, h = tuple(case["X"]), tuple(case["tau"]), case["t"], case["rk4_h"]
        d = tuple(disturbance(harmonics, t + j * h / 2) for j in range(3))
        assert close(derivative(K, state, tau, d[0]), case["Xdot"], 1e-12)
        assert close(rk4_step(K, state, tau, d, h), case["X_next"], 1e-12)


@given(states)
def test_coriolis_terms_do_no_work(state: State) -> None:
    """nu' C(nu) nu = 0: without damping, restoring and thrust the kinetic energy stands still."""
    rate = derivative(NO_DAMPING, state, REST, NO_FORCE)
    assert abs(power(NO_DAMPING, state, rate)) < 1e-9


@given(states)
def test_damping_dissipates(state: State) -> None:
    """Without thrust and restoring the energy falls by sum of beta nu^2, and by nothing else."""
    k = coefficients(replace(PARAMS, beta_b=0.0))
    rate = derivative(k, state, REST, NO_FORCE)
    loss = sum(beta * n * n for beta, n in zip(k[5:10], state[5:], strict=True))
    assert power(k, state, rate) == pytest.approx(-loss, abs=1e-9)


@given(states)
def test_speed_over_ground_is_the_same_in_both_frames(state: State) -> None:
    """The rotation of eq. (1) keeps lengths."""
    rate = derivative(K, state, REST, NO_FORCE)
    assert math.hypot(*rate[:3]) == pytest.approx(math.hypot(*state[5:8]), abs=1e-12)


def test_integration_is_of_fourth_order() -> None:
    """Halving the step divides the error by 2^4 on the unforced vehicle."""

    def run(n: int) -> State:
        state: State = (0.0, 0.0, 0.0, 0.4, 0.3, 1.2, -0.5, 0.6, 0.5, -0.7)
        for _ in range(n):
            state = rk4_step(K, state, REST, CALM_SEA, 1.0 / n)
        return state

    exact = run(4096)
    errors = [math.dist(run(n), exact) for n in (32, 64, 128)]
    assert 14.0 < errors[0] / errors[1] < 18.0
    assert 14.0 < errors[1] / errors[2] < 18.0


@given(course, st.tuples(speed, speed))
def test_a_level_vehicle_that_drifts_with_the_current_feels_nothing(psi: float, flow: tuple[float, float]) -> None:
    cx, cy = flow
    u = math.cos(psi) * cx + math.sin(psi) * cy
    v = -math.sin(psi) * cx + math.cos(psi) * cy
    rate = derivative(K, (0.0, 0.0, 0.0, 0.0, psi, u, v, 0.0, 0.0, 0.0), REST, NO_FORCE, (cx, cy, 0.0))
    assert close(rate[:3], (cx, cy, 0.0), 1e-12)
    assert close(rate[3:], (0.0,) * 7, 1e-12)


@settings(max_examples=25)
@given(states, commands, currents)
def test_a_current_only_carries_the_motion_along(state: State, tau: Vec3, current: Vec3) -> None:
    """Galileo: the same vehicle in moving water makes the same motion, seen from the water.

    Also while it turns: this is what the term -omega x nu_c in the body axes is for.
    """
    h, n = 0.0005, 200
    _, _, _, theta, psi, u, v, w, q, r = state
    state = (0.0, 0.0, 0.0, theta / 2, psi, u / 2, v / 2, w / 2, q / 2, r / 2)
    calm, carried = state, with_current(state, current)
    for _ in range(n):
        calm = rk4_step(K, calm, tau, CALM_SEA, h)
        carried = rk4_step(K, carried, tau, CALM_SEA, h, current)
    t = n * h
    expected = with_current(calm, current)
    drift = tuple(c * t for c in current)
    assert close(carried[:3], [p + d for p, d in zip(expected[:3], drift, strict=True)], 1e-8)
    assert close(carried[3:], expected[3:], 1e-8)


def with_current(state: State, current: Vec3) -> State:
    """The state whose velocity through water moving with `current` is that of `state` in calm water."""
    x, y, z, th, ps, u, v, w, q, r = state
    cx, cy, cz = current
    along = math.cos(ps) * cx + math.sin(ps) * cy
    return (
        x, y, z, th, ps,
        u + math.cos(th) * along - math.sin(th) * cz,
        v - math.sin(ps) * cx + math.cos(ps) * cy,
        w + math.sin(th) * along + math.cos(th) * cz,
        q, r,
    )  # fmt: skip


def test_the_papers_disturbance() -> None:
    for t in (0.0, 0.7, 12.3):
        s, c = math.sin(t), math.cos(t)
        assert close(disturbance(PAPER, t), (3.1 * s, 3.1 * c, 2.1 * s, 1.1 * s, 1.1 * s), 1e-13)
    assert disturbance(PAPER[:2], 0.7)[2:] == (0.0, 0.0, 0.0)
    assert disturbance((), 0.7) == NO_FORCE


@pytest.mark.parametrize("theta", [math.pi / 2, -math.pi / 2, 1.5 * math.pi, math.pi / 2 + 0.5 * NEAR_VERTICAL])
def test_a_vertical_vehicle_moves_on(theta: float) -> None:
    """Nobody is frozen: it keeps being integrated, turns finitely, and its restoring moment brings it down."""
    config = world_config()
    vertical = VehicleSetup(7, (0.0, 0.0, 0.0, theta, 0.0), (1.0, 0.1, 0.1, 0.0, 1.0), PARAMS, TAU_MAX)
    world = World(replace(config, vehicles=(*config.vehicles, vertical)))
    headings = []
    for _ in range(3000):
        world.advance(7, REST)
        headings.append(world.state(7)[0][4])
    assert world.tick(7) == 3000
    assert max(abs(b - a) for a, b in pairwise(headings)) < 0.01 * 1.53 / NEAR_VERTICAL * 1.2
    assert abs(math.remainder(world.pitch(7)[0], 2 * math.pi)) < 1.0


def test_far_from_the_vertical_the_printed_heading_rate_stands_bit_for_bit() -> None:
    for theta in (0.0, 0.3, -1.2, math.acos(NEAR_VERTICAL), math.pi - 1.2, 1.9):
        if abs(math.cos(theta)) >= NEAR_VERTICAL:
            rate = derivative(K, (0.0, 0.0, 0.0, theta, 0.4, 1.0, 0.2, 0.1, 0.3, 0.7), REST, NO_FORCE)
            assert rate[4] == 0.7 / math.cos(theta)


@given(st.floats(-NEAR_VERTICAL, NEAR_VERTICAL))
def test_turn_per_yaw(c: float) -> None:
    """Odd, bounded, 0 at the vertical, and nowhere farther from 0 than 1 / cos(theta)."""
    f = turn_per_yaw(c)
    assert f == -turn_per_yaw(-c)
    assert abs(f) <= 1.53 / NEAR_VERTICAL
    assert 0.0 <= f * c <= 1.0 + 1e-15
    assert turn_per_yaw(0.0) == 0.0


def test_turn_per_yaw_joins_the_printed_rate_with_four_derivatives() -> None:
    """Both as polynomials about the bound: the inner one's first terms are 1/s = 1 - e + e^2 - e^3 + e^4 - ..."""
    inner = np.polynomial.Polynomial([0, 5, 0, -10, 0, 10, 0, -5, 0, 1])
    assert inner(0.3) / NEAR_VERTICAL == pytest.approx(turn_per_yaw(0.3 * NEAR_VERTICAL))
    shifted = inner(np.polynomial.Polynomial([1.0, 1.0])).coef
    assert shifted[:5] == pytest.approx([1.0, -1.0, 1.0, -1.0, 1.0])
    assert shifted[5] != pytest.approx(-1.0)


def through_the_vertical(h: float, until_s: float, current: Vec3 = ZERO, start: State | None = None) -> State:
    """A vehicle that pitches up through the vertical at about 2 rad/s while it yaws, after `until_s`."""
    state: State = start or (0.0, 0.0, 5.0, 1.2, 0.3, 1.0, 0.2, 0.1, 2.0, 0.6)
    for _ in range(round(until_s / h)):
        state = rk4_step(K, state, (5.0, 8.0, 0.5), CALM_SEA, h, current)
    return state


def test_rk4_keeps_its_fourth_order_through_the_vertical() -> None:
    exact = through_the_vertical(0.0005, 0.4)
    assert math.cos(exact[3]) < -NEAR_VERTICAL  # it has passed
    errors = [max(abs(a - b) for a, b in zip(through_the_vertical(h, 0.4), exact, strict=True)) for h in (0.004, 0.002)]
    assert errors[0] / errors[1] > 2**3.5, errors


def test_what_a_passage_of_the_vertical_gives_does_not_depend_on_where_steps_fall() -> None:
    """With the default step: the heading behind it is the same to a milliradian, wherever the first step began."""
    exact = through_the_vertical(0.0005, 0.4)
    for early in (0.001, 0.002, 0.003, 0.004):
        begun = through_the_vertical(0.0005, early)
        there = through_the_vertical(0.005, 0.395, start=begun)
        there = through_the_vertical(0.0005, 0.005 - early, start=there)
        assert close(there[3:5], exact[3:5], 1e-3), (there, exact)


@pytest.mark.parametrize("current", [(0.3, -0.2, 0.1), (0.0, 0.0, -0.5)])
def test_a_current_carries_a_passage_of_the_vertical_along(current: Vec3) -> None:
    """Galilean invariance holds where the heading rate is regularised, too."""
    start = (0.0, 0.0, 5.0, 1.2, 0.3, 1.0, 0.2, 0.1, 2.0, 0.6)
    calm = through_the_vertical(0.001, 0.4)
    carried = through_the_vertical(0.001, 0.4, current, with_current(start, current))
    expected = with_current(calm, current)
    assert close(carried[:3], [p + 0.4 * c for p, c in zip(expected[:3], current, strict=True)], 1e-6)
    assert close(carried[3:], expected[3:], 1e-6)


@given(st.floats(-3.0, 3.0), st.floats(1.5, 1.65))
def test_damping_dissipates_through_the_vertical(turn: float, theta: float) -> None:
    """Kinetic plus restoring energy never grows without thrust: the heading rate does no work."""
    state: State = (0.0, 0.0, 0.0, theta, 0.0, 1.0, 0.3, -0.2, 0.5, turn)

    def energy(s: State) -> float:
        return sum(m * n * n for m, n in zip(K[:5], s[5:], strict=True)) / 2 - K.beta_b * math.cos(s[3])

    for _ in range(40):
        after = rk4_step(K, state, REST, CALM_SEA, 0.005)
        assert energy(after) <= energy(state) + 1e-9
        state = after


@pytest.mark.parametrize("u", [1e200, 1e308])
def test_a_motion_that_leaves_the_finite_numbers_is_an_error(u: float) -> None:
    runaway = VehicleSetup(1, (0.0, 0.0, 0.0, 0.0, 0.0), (u, u, u, 1e150, 1e150), PARAMS, TAU_MAX)
    world = World(replace(world_config(), vehicles=(runaway,)))
    before = world.tick(1), world.state(1)
    with pytest.raises(IntegrationError) as caught:
        world.advance(1, REST)
    assert caught.value.reason == "the motion left the finite numbers"
    assert (world.tick(1), world.state(1)) == before


def test_actuators_limit_and_refuse() -> None:
    world = World(world_config())
    assert world.actuate(1, (25.0, -25.0, 3.0)) == (20.0, -20.0, 3.0)
    for tau in ((math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0), ()):
        with pytest.raises(WorldError) as caught:
            world.actuate(2, tau)
        assert str(caught.value) == f"vehicle 2, tick 0: expected tau as three finite numbers, got {tau!r}"
    with pytest.raises(WorldError, match="vehicle 9 is not in this world, which has"):
        world.actuate(9, REST)


@settings(max_examples=20)
@given(
    st.lists(st.sampled_from((1, 2, 3, 4)), max_size=60), st.integers(1, 3), st.sampled_from((ZERO, (0.2, -0.1, 0.05)))
)
def test_the_fleet_is_every_vehicle_alone(order: list[int], substeps: int, current: Vec3) -> None:
    """Vehicles meet only in the network: running ahead of each other, in any order, changes no bit."""
    config = world_config(PAPER, substeps, current)
    together = World(config)
    alone = {i: World(replace(config, vehicles=(config.vehicles[i - 1],))) for i in together.ids}
    for i in order:
        tau = (5.0 * i, math.sin(together.tick(i)), -0.3 * i)
        together.advance(i, tau)
        alone[i].advance(i, tau)
    for i in together.ids:
        assert together.tick(i) == alone[i].tick(i) == order.count(i)
        assert together.state(i) == alone[i].state(i)


def noisy(noise: NavNoise, vehicles: int = 4, seed: int = 1) -> WorldConfig:
    config = world_config()
    return replace(config, seed=seed, noise=noise, vehicles=config.vehicles[:vehicles])


def test_without_noise_the_sensor_tells_the_truth() -> None:
    world = World(noisy(NavNoise()))
    assert all(world.sense(i) == (*world.state(i), ()) for i in world.ids)


def test_noise_depends_on_nothing_but_seed_vehicle_tick_and_component() -> None:
    """Another fleet size, another order, a repeated reading, another component's noise: same draws."""
    noise = NavNoise(0.1, 0.01, 0.2, 0.02)
    world, smaller = World(noisy(noise)), World(noisy(noise, vehicles=2))
    readings = [world.sense(i) for i in (1, 2, 3, 4)]
    assert [world.sense(i) for i in (4, 3, 2, 1)] == readings[::-1]
    assert [smaller.sense(i) for i in (1, 2)] == readings[:2]
    assert World(noisy(noise, seed=2)).sense(1) != readings[0]
    only_rates = World(noisy(NavNoise(rate_radps=0.02))).sense(1)
    assert only_rates[1][3:] == readings[0][1][3:]
    assert only_rates[0] == world.state(1)[0]
    world.advance(1, REST)
    smaller.advance(1, REST)
    assert world.sense(1) == smaller.sense(1) != readings[0]


def test_noise_has_its_standard_deviation() -> None:
    world = World(noisy(NavNoise(position_m=0.5), vehicles=1))
    errors = []
    for _ in range(800):
        errors += [a - b for a, b in zip(world.sense(1)[0][:3], world.position(1), strict=True)]
        world.advance(1, REST)
    assert abs(fmean(errors)) < 0.05
    assert pstdev(errors) == pytest.approx(0.5, rel=0.06)


def test_the_disturbance_goes_on_from_step_to_step_and_from_tick_to_tick() -> None:
    """Each RK4 step ends with the force with which the next one begins; in its middle and at its end it is another."""
    world = World(world_config(PAPER))
    steps = [step for tick in range(3) for step in world._stage_forces_at(tick)]
    assert len(steps) == 6
    for (start, middle, end), (following, _, _) in pairwise(steps):
        assert end == pytest.approx(following)
        assert start != middle != end
