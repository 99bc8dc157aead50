"""The filter is consistent, and its drift is that of the closed formulas; on a given course, without a world."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin, sqrt

import numpy as np
import pytest

from netem.wire.messages import Fix, WorldFault
from world.navigation.config import DeadReckoning, FixSource, Grade
from world.navigation.filter import GATE, E, N, NavigationFilter
from world.navigation.navigator import Navigator, State

TICK_NS = 100_000_000
NONE = Grade(1.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 5.0, 0.0, 0.0, 100.0, 5.0, 0.0, 0.0, 0.0)
DEG = pi / 180.0
ALL = Grade(
    heading_rate=1.0, heading_bias=2 * DEG, heading_noise=1 * DEG, heading_walk=0.02 * DEG,
    gyro_rate=10.0, gyro_bias=0.01 * DEG, gyro_walk=0.02 * DEG,
    dvl_rate=5.0, dvl_scale=0.01, dvl_noise=0.02, dvl_altitude=50.0,
    depth_rate=5.0, depth_bias=0.2, depth_noise=0.05, tilt=0.5 * DEG,
)  # fmt: skip
USBL = FixSource("usbl", 10_000_000_000, 1_000_000_000, 0.2, 1.0, 0.01, (0.0, 0.0, 0.0))


def config(grade: Grade, *fixes: FixSource, **changes: float) -> DeadReckoning:
    return replace(DeadReckoning(grade, 0.0, None, 0.0, 600.0, fixes), **changes)  # type: ignore[arg-type]


def course(k: int, turning: float = 0.0, speed: float = 1.0) -> State:
    """North, or in circles, 10 m deep; the step from tick to tick is exact."""
    t = k * TICK_NS / 1e9
    if not turning:
        return speed * t, 0.0, 10.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0
    psi, radius = turning * t, speed / turning
    return radius * sin(psi), radius * (1 - cos(psi)), 10.0, 0.0, psi, speed, 0.0, 0.0, 0.0, turning


def voyage(
    setup: DeadReckoning,
    seconds: float,
    seed: int = 1,
    turning: float = 0.0,
    current: tuple[float, float, float] = (0.0, 0.0, 0.0),
    faults: tuple[WorldFault, ...] = (),
) -> tuple[Navigator, np.ndarray, list[Fix]]:
    """The navigator after a time, the error of n, e, z and psi of its estimate, and its fixes."""
    navigator = Navigator(setup, seed, 1, TICK_NS, course(0, turning))
    ticks = round(seconds * 1e9) // TICK_NS
    after = course(0, turning)
    for k in range(ticks):
        before, after = after, course(k + 1, turning)
        navigator.step(before, after, current, faults, 0.0)
    navigator.filter.settle()
    (x, y, z, _, psi), _, _ = navigator.belief(after, ())
    return navigator, np.array([x, y, z, psi]) - np.array([*after[:3], after[4]]), [*navigator.take_fixes()]


def covariance(navigator: Navigator) -> np.ndarray:
    p = np.zeros((4, 4))
    p[np.triu_indices(4)] = navigator.covariance()
    return p + np.triu(p, 1).T


@pytest.mark.parametrize(
    ("setup", "current"),
    [
        pytest.param(config(ALL, start=1.0), 0.0, marks=pytest.mark.slow),
        pytest.param(config(ALL, USBL, start=1.0), 0.0, marks=pytest.mark.slow),
        (config(ALL, USBL, bottom=200.0, current_sigma=0.2, current_time_s=1e9, start=1.0), 0.2),
    ],
    ids=["dead reckoning", "with fixes", "through the water"],
)
def test_the_filter_is_consistent(setup: DeadReckoning, current: float) -> None:
    """NEES of 100 seeds has a chi-square distribution with four degrees of freedom (95 % interval of its mean), and NIS
    of the fixes one with two (Bar-Shalom, Li and Kirubarajan 2001, ch. 5.4)."""
    nees, nis = [], []
    drawn = np.random.default_rng(1).normal(0.0, 1.0, (100, 2))
    for seed in range(100):
        flow = (current * drawn[seed, 0], current * drawn[seed, 1], 0.0)
        navigator, off, fixes = voyage(setup, 40.0, seed, 0.05, flow)
        nees.append(off @ np.linalg.solve(covariance(navigator), off))
        nis += [fix.nis for fix in fixes]
    assert 3.46 < np.mean(nees) < 4.57  # chi-square with 400 degrees of freedom, over 100
    if nis:
        count = len(nis)
        assert np.mean(nis) == pytest.approx(2.0, abs=1.96 * sqrt(4.0 / count))
        assert sum(not fix.used for fix in fixes) == 0


def test_a_heading_bias_gives_a_cross_track_error_of_bias_times_distance() -> None:
    navigator, off, _ = voyage(config(replace(NONE, heading_bias=1 * DEG)), 300.0)
    bias = off[3]
    assert bias
    assert off[:2] == pytest.approx([300.0 * (cos(bias) - 1.0), 300.0 * sin(bias)], abs=1e-9)
    assert navigator.filter.sigma(E) == pytest.approx(1 * DEG * 300.0, rel=1e-3)


def test_a_scale_error_gives_an_error_along_the_track() -> None:
    navigator, off, _ = voyage(config(replace(NONE, dvl_scale=0.01)), 300.0)
    assert off[0] == pytest.approx(300.0 * (navigator._instruments.scale - 1.0))
    assert off[1] == 0.0
    assert navigator.filter.sigma(N) == pytest.approx(3.0, rel=0.05)  # its measure is 2 % short


def test_noise_of_the_dvl_makes_a_random_walk() -> None:
    """It grows with the square root of time: sigma sqrt(T t), with T from sample to sample."""
    setup = config(replace(NONE, dvl_noise=0.05))
    for seconds in (15.0, 60.0):
        expected = 0.05 * sqrt(0.2 * seconds)
        found = np.array([voyage(setup, seconds, seed)[1][:2] for seed in range(60)])
        assert np.sqrt(np.mean(found**2)) == pytest.approx(expected, rel=0.1)
    assert voyage(setup, 60.0)[0].filter.sigma(N) == pytest.approx(expected)


def test_without_sight_of_the_floor_the_current_is_an_error() -> None:
    blind, current = config(NONE, bottom=200.0), (0.1, -0.2, 0.0)
    _, off, _ = voyage(blind, 100.0, current=current)
    assert off[:2] == pytest.approx([-0.1 * 100.0, 0.2 * 100.0])
    assert voyage(replace(blind, bottom=100.0), 100.0, current=current)[1][:2] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_no_errors_no_drift() -> None:
    _, off, _ = voyage(config(NONE), 100.0, turning=0.1)
    assert off == pytest.approx([0.0] * 4, abs=1e-3)  # chords in place of arcs


def test_a_fix_bounds_the_error_and_an_outlier_is_refused() -> None:
    setup = config(ALL, replace(USBL, loss=0.0, growth=0.0), start=1.0)
    free, bound = voyage(config(ALL, start=1.0), 300.0)[0], voyage(setup, 300.0)[0]
    assert bound.filter.sigma(E) < 0.3 * free.filter.sigma(E)
    jumping = WorldFault("f", 0, None, "fix", (), (0.0, 0.0, 0.0, 500.0, 0.3))  # type: ignore[arg-type]
    _, off, fixes = voyage(setup, 300.0, faults=(jumping,))
    refused = [fix for fix in fixes if not fix.used]
    assert 3 <= len(refused) <= 15
    assert all(fix.nis > GATE for fix in refused)
    assert abs(off[:2]).max() < 5.0


def test_many_fixes_in_a_row_that_agree_are_right() -> None:
    """A filter that is sure and wrong believes the sixth."""
    known = NavigationFilter(config(NONE, start=0.1), 0.0, 0.0, 0.0)
    used = []
    for key in range(6):
        known.keep_position(key)
        used.append(known.position(key, 100.0, 0.0, 1.0)[1])
    assert used == [False] * 5 + [True]
    assert known.x[N] == pytest.approx(100.0, abs=0.1)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("dvl", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ("dvl", (0.0, 0.1, 0.0, 0.0, 0.0, 0.0)),
        ("dvl", (0.0, 0.0, 0.0, 0.0, 1.0, 0.1)),
        ("compass", (0.0, 0.3, 0.0, 0.0)),
        ("compass", (1.0, 0.0, 0.0, 0.0)),
        ("compass", (0.0, 0.0, 0.5, 0.5)),
        ("fix", (1.0, 0.0, 0.0, 0.0, 0.0)),
        ("fix", (0.0, 3.0, 0.0, 0.0, 0.0)),
    ],
)
def test_faults_change_what_is_believed(kind: str, values: tuple[float, ...]) -> None:
    setup = config(ALL, replace(USBL, loss=0.0), start=1.0)
    fault = WorldFault("f", 0, None, kind, (), values)  # type: ignore[arg-type]
    well, ill = (voyage(setup, 60.0, turning=0.05, faults=faults) for faults in ((), (fault,)))
    assert abs(well[1] - ill[1]).max() > 1e-3
    if kind == "dvl" and values[0] == 1.0:
        assert ill[0].filter.sigma(N) > 1.5 * well[0].filter.sigma(N)  # and it knows
