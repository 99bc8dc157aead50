"""REMUS 100: side by side with an independent implementation, its actuators, and the water."""

from __future__ import annotations

from importlib.util import find_spec
from math import degrees, hypot, isfinite, pi, radians

import numpy as np
import pytest
from remus_reference import MANOEUVRES, MEASURES, Run, driven, reference, stored
from repository import ROOT

from fleet.scenario.sections.vehicle_files import load_vehicle
from world.api import PlantConfig, Vec3, Vec6, Water
from world.plants.classes import plant_class
from world.plants.remus100 import BODY, FIN_LIMIT, HULLS, N_LIMIT, Hull, Remus100, advance, allocate, revolution

MODEL = load_vehicle("remus100")
STILL = Water((0.0, 0.0, 0.0), (0.0,) * 6)
PLACE: Vec6 = (0.0, 0.0, 5.0, 0.0, 0.0, 0.0)
CRUISE: Vec6 = (1.5, 0.0, 0.0, 0.0, 0.0, 0.0)
# Largest deviation in any row from the reference that has our terms of the hull: what its Euler steps of 1 ms leave.
CLOSE = {"m": 0.05, "rad": 0.003, "m/s": 0.006, "rad/s": 0.002, "rpm": 0.3, "fin": 1e-3}
UNITS = ["m"] * 3 + ["rad"] * 3 + ["m/s"] * 3 + ["rad/s"] * 3 + ["rpm", "fin", "fin"]


def plant(hull: Hull = "fossen") -> Remus100:
    return Remus100(PlantConfig(1, 0.01, 1, MODEL.params), hull)


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    return {name: driven(manoeuvre) for name, manoeuvre in MANOEUVRES.items()}


@pytest.mark.parametrize("name", MANOEUVRES)
def test_it_moves_as_the_reference_with_the_same_hull(name: str, runs: dict[str, Run]) -> None:
    _, same_hull = stored()[name]
    deviation = np.abs(runs[name] - same_hull).max(axis=0)
    assert {u: d for u, d in zip(UNITS, deviation, strict=True) if d > CLOSE[u]} == {}


def test_the_table_of_deviations_is_what_the_runs_come_to(runs: dict[str, Run]) -> None:
    page = (ROOT / "docs" / "background" / "plants.md").read_text("utf-8")
    table = stored()
    rows = []
    for words, name, decimals, number in MEASURES:
        ours, theirs, same_hull = (number(run) for run in (runs[name], *table[name]))
        rows.append(
            f"| {words} | {ours:.{decimals}f} | {theirs:.{decimals}f} | {_percent(ours, theirs, 1)} "
            f"| {_percent(ours, same_hull, 2)} |"
        )
    missing = [row for row in rows if row not in page]
    assert missing == [], "\n" + "\n".join(rows)


def _percent(ours: float, theirs: float, decimals: int) -> str:
    return f"{round(100.0 * (ours / theirs - 1.0), decimals) + 0.0:+.{decimals}f} %"


@pytest.mark.slow
@pytest.mark.skipif(find_spec("python_vehicle_simulator") is None, reason="python_vehicle_simulator is not installed")
@pytest.mark.parametrize("our_hull", [False, True])
def test_the_stored_runs_are_those_of_the_reference(our_hull: bool) -> None:
    found = reference(MANOEUVRES["abeam"]._replace(seconds=10), our_hull)
    assert np.abs(found - stored()["abeam"][our_hull][: len(found)]).max() < 1e-3


# --- the hull by Prestero ---------------------------------------------------


def circle(rudder: float, hull: Hull) -> tuple[float, float]:
    """Diameter [m] and yaw rate [deg/s] of the steady turn at 1200 rpm with the rudder at an angle [deg]."""
    state: tuple[float, ...] = (*PLACE, *CRUISE, 1200.0, 0.0, 0.0)
    for _ in range(3000):
        state = advance(state, (1200.0, radians(rudder), 0.0), STILL, 0.02, hull)
    return 2.0 * hypot(state[6], state[7]) / state[11], degrees(state[11])


def level_circle(rudder: float) -> float:
    """Diameter [m] by Prestero's two equations of a steady level turn, with a = v / u < 0 and b = r / u > 0 [1/m]."""
    delta = radians(rudder)
    low, high = 0.0, 1.0
    for _ in range(60):
        a = -0.5 * (low + high)
        # The yaw moment gives b, the side force then decides: 94 b^2 + 2 b = 3.18 a^2 - 24 a + 6.15 delta.
        b = (-2.0 + (4.0 + 4.0 * 94.0 * (3.18 * a * a - 24.0 * a + 6.15 * delta)) ** 0.5) / 188.0
        side = 1310.0 * a * a + 0.632 * b * b + (5.22 - 30.48) * b - 28.6 * a - 9.64 * delta
        low, high = (-a, high) if side < 0.0 else (low, -a)
    return 2.0 * hypot(1.0, a) / b


@pytest.mark.parametrize(("rudder", "diameter"), [(5.0, 16.6), (15.0, 11.7)])
def test_prestero_s_hull_turns_in_his_circle(rudder: float, diameter: float) -> None:
    """Which his equations give in the plane; heel and pitch change it by less than one per cent."""
    found, _ = circle(rudder, "prestero")
    assert found == pytest.approx(diameter, abs=0.05)
    assert found == pytest.approx(level_circle(rudder), rel=0.01)


def test_the_table_of_circles_is_what_the_hulls_turn() -> None:
    page = (ROOT / "docs" / "background" / "plants.md").read_text("utf-8")
    rows = []
    for rudder in (2, 5, 10, 15):
        (ours, slow), (his, quick) = circle(rudder, "fossen"), circle(rudder, "prestero")
        rows.append(
            f"| {rudder} deg | {ours:.1f} m, {slow:.1f} deg/s | {his:.1f} m, {quick:.1f} deg/s | {ours / his:.1f} |"
        )
    assert [row for row in rows if row not in page] == [], "\n" + "\n".join(rows)


def test_prestero_s_hull_does_not_keep_its_course_by_itself() -> None:
    for hull, turns in (("fossen", False), ("prestero", True)):
        state: tuple[float, ...] = (*PLACE, *CRUISE[:5], 0.01, 0.0, 0.0, 0.0)  # the propeller stands
        for _ in range(150):
            state = advance(state, (0.0, 0.0, 0.0), STILL, 0.02, hull)
        assert (state[11] > 0.02) == turns


def test_his_fins_give_the_moments_that_are_asked_for() -> None:
    _, rudder, stern = allocate((12.0, -1.0, 0.8), (1.5, 0.0, 0.0), "prestero")
    assert 6.15 * 1.5**2 * rudder == pytest.approx(0.8, rel=1e-3)
    assert 6.15 * 1.5**2 * stern == pytest.approx(1.0, rel=1e-3)


def test_another_hull_is_refused() -> None:
    with pytest.raises(ValueError, match="expected hull as one of fossen, prestero, got 'fosen'"):
        Remus100(PlantConfig(1, 0.01, 1, MODEL.params), "fosen")  # type: ignore[arg-type]


# --- actuators -----------------------------------------------------------


def test_it_ships_with_a_model_for_controllers() -> None:
    found = plant_class("remus100", {})
    assert found is Remus100
    assert Remus100.limits == pytest.approx(MODEL.tau_max, rel=0.01)
    m1, m2, m3, m4, m5 = MODEL.params.inertia
    assert (m1, m4, m5) == pytest.approx(
        (BODY.m + BODY.added[0], BODY.Iy + BODY.added[4], BODY.Iz + BODY.added[5]), rel=0.01
    )
    assert m1 == m2 == m3  # the plant has no Munk moment that a controller could compensate


def test_at_cruise_the_actuators_give_what_was_asked_for() -> None:
    n, rudder, stern = allocate((12.0, -1.0, 0.8), (1.5, 0.0, 0.0))
    rps, D, half_rho_u2 = n / 60.0, 0.14, 0.5 * 1026.0 * 1.5**2
    J = 0.944 * 1.5 / (rps * D)
    thrust = 0.9 * 1026.0 * D**4 * rps**2 * (0.4566 + (0.1798 - 0.4566) / 0.6632 * J)
    assert thrust == pytest.approx(12.0, rel=1e-6)
    assert -(0.8 * half_rho_u2 * 0.0133 * 0.7) * stern == pytest.approx(-1.0, rel=1e-3)
    assert 0.8 * half_rho_u2 * 0.0133 * 0.5 * rudder == pytest.approx(0.8, rel=1e-3)


def test_actuators_keep_their_limits() -> None:
    assert allocate((1e4, 1e4, 1e4), (1.5, 0.0, 0.0)) == pytest.approx((N_LIMIT, FIN_LIMIT, -FIN_LIMIT))
    n, rudder, stern = allocate((-1e4, -1e4, -1e4), (1.5, 0.0, 0.0))
    assert (rudder, stern) == pytest.approx((-FIN_LIMIT, FIN_LIMIT))
    assert 0.0 < n == pytest.approx(0.5 * revolution(0.0, 1.5))  # it brakes as hard as it can, and is not reversed
    assert allocate((-1.0, 0.0, 0.0), (-0.5, 0.0, 0.0))[0] == 0.0


def test_fins_have_no_force_at_low_speed_and_are_not_thrown_about() -> None:
    assert allocate((0.0, 5.0, 5.0), (0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    angles = [abs(allocate((0.0, 0.0, 0.02), (u, 0.0, 0.0))[1]) for u in (0.01, 0.03, 0.1)]
    assert angles == sorted(angles)
    p = plant()
    state = p.start(PLACE, (0.0,) * 6)
    for _ in range(200):
        state = p.step(state, (0.0, 0.0, 4.0), STILL, 0.01)
    assert p.velocity(state)[5] == pytest.approx(0.0, abs=1e-12)


def test_lags_are_those_of_motor_and_servo() -> None:
    state: tuple[float, ...] = (*PLACE, *CRUISE, 0.0, 0.0, 0.0)
    for _ in range(10):
        state = advance(state, (1000.0, 0.1, -0.2), STILL, 0.01)
    assert state[12:] == pytest.approx((1000.0 * (1 - np.exp(-0.1)), 0.1 * (1 - np.exp(-1)), -0.2 * (1 - np.exp(-1))))


def test_it_begins_at_its_speed_and_reports_its_actuators() -> None:
    p = plant()
    state = p.start(PLACE, CRUISE)
    assert (p.pose(state), p.velocity(state)) == (PLACE, CRUISE)
    for _ in range(1000):
        state = p.step(state, (13.74, 0.0, 0.0), STILL, 0.01)
    assert p.velocity(state)[0] == pytest.approx(1.5, abs=0.01)
    report = p.report(state)
    assert list(report) == [signal.name for signal in Remus100.signals]
    assert report["rpm"] == pytest.approx(report["rpm_cmd"], rel=0.01)


# --- the water -------------------------------------------------------------


@pytest.mark.parametrize("hull", HULLS)
def test_a_current_only_carries_the_whole_motion_along(hull: Hull) -> None:
    current: Vec3 = (0.3, -0.4, 0.1)
    tau = (15.0, -0.5, 0.6)
    p = plant(hull)
    still = p.start(PLACE, CRUISE)
    carried = still[:6] + tuple(a + b for a, b in zip(CRUISE[:3], current, strict=True)) + still[9:]
    for _ in range(1000):
        still = p.step(still, tau, STILL, 0.01)
        carried = p.step(carried, tau, Water(current, (0.0,) * 6), 0.01)
    moved_on = [a + 10.0 * c for a, c in zip(still[:3], current, strict=True)]
    assert carried[:3] == pytest.approx(moved_on, abs=1e-6)
    assert carried[3:6] == pytest.approx(still[3:6], abs=1e-8)
    assert abs(still[5]) > 0.3  # it did turn


@pytest.mark.parametrize("hull", HULLS)
def test_what_it_does_to_port_it_does_to_starboard(hull: Hull) -> None:
    def turn(rudder: float) -> tuple[float, ...]:
        state: tuple[float, ...] = (*PLACE, *CRUISE, 0.0, 0.0, 0.0)  # the propeller stands: its torque is one-sided
        for _ in range(500):
            state = advance(state, (0.0, rudder, 0.0), STILL, 0.01, hull)
        return state

    port, starboard = turn(-0.2), turn(0.2)
    odd = (1, 3, 5, 7, 9, 11, 13)
    assert [-x if i in odd else x for i, x in enumerate(port)] == pytest.approx(starboard, abs=1e-12)
    assert starboard[5] > 0.1


@pytest.mark.parametrize("hull", HULLS)
@pytest.mark.parametrize("theta", [0.5 * pi, -0.5 * pi, radians(89.9)])
def test_it_stays_finite_on_its_nose_and_tail_and_astern(theta: float, hull: Hull) -> None:
    p = plant(hull)
    state = p.start((0.0, 0.0, 5.0, 0.3, theta, 0.0), (-1.0, 0.4, 0.2, 1.0, 1.0, 1.0))
    for _ in range(1000):
        state = p.step(state, (50.0, 5.0, 4.0), Water((0.0, 0.0, 0.0), (3.0, 3.0, 2.0, 0.1, 1.0, 1.0)), 0.01)
    assert all(map(isfinite, state))
    assert max(map(abs, p.velocity(state))) < 5.0
