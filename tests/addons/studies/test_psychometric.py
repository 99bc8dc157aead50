"""Where a pass rate falls through a level: the estimate is near the truth, and its interval holds it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fleet.addons.studies.psychometric import (
    ENDS,
    RISING,
    SCALES,
    Array,
    PsychometricCurve,
    Rise,
    Walk,
    _fisher,
    steepest_rise,
)

CURVE = PsychometricCurve(np.linspace(0.0, 1.0, 65).tolist())


def rate(border: float, scale: float, x: float) -> float:
    return float(1.0 / (1.0 + np.exp((x - border) / scale)))


def runs_of(passes: Callable[[float], bool], count: int) -> list[tuple[int, bool]]:
    runs: list[tuple[int, bool]] = []
    while len(runs) < count:
        asked = CURVE.most_informative(CURVE.posterior(runs), 4) if runs else [0, 21, 43, 64]
        runs += [(k, passes(float(CURVE.positions[k]))) for k in asked]
    return runs


def test_the_interval_holds_the_truth_after_few_runs() -> None:
    rng = np.random.default_rng(5)
    held, off = 0, []
    for border in rng.uniform(0.1, 0.9, 10):
        runs = runs_of(lambda x, border=border: bool(rng.random() < rate(border, 0.05, x)), 32)
        found = CURVE.belief(CURVE.posterior(runs))
        held += found.low <= border <= found.high
        off.append(abs(found.border - border))
    assert held >= 9
    assert float(np.median(off)) < 0.025


def test_a_sharp_border_is_found_between_two_places() -> None:
    found = CURVE.belief(CURVE.posterior(runs_of(lambda x: x < 0.4, 24)))
    assert 0.38 < found.low < found.border < found.high < 0.42


@pytest.mark.slow
@pytest.mark.parametrize(("best", "worst"), [(0.7, 0.0), (1.0, 0.2)])
def test_a_curve_that_does_not_fall_from_1_to_0_moves_the_border_little(best: float, worst: float) -> None:
    """With curves from 1 to 0 alone the border was 7 % of the range too low where the best pass rate is 0.7."""
    walk = Walk(PsychometricCurve(np.linspace(0.0, 1.0, 16).tolist()), 0.1)
    rng = np.random.default_rng(11)
    held, off = 0, []
    for middle in rng.uniform(0.2, 0.8, 20):
        truth = middle + 0.03 * np.log((best - 0.5) / (0.5 - worst))  # where the pass rate is one half
        runs: list[tuple[int, bool]] = []
        while len(runs) < 60 and (asked := walk.next_runs(runs)):
            rates = [worst + (best - worst) * rate(middle, 0.03, walk.curve.positions[k]) for k in asked]
            runs += [(k, bool(rng.random() < p)) for k, p in zip(asked, rates, strict=True)]
        found = walk.curve.belief(walk.curve.posterior(runs))
        held += found.low <= truth <= found.high
        off.append(found.border - truth)
    assert held >= 17
    assert abs(float(np.mean(off))) < 0.03


@pytest.mark.parametrize("passes", [True, False])
def test_a_border_outside_is_told_after_eight_runs(passes: bool) -> None:
    found = CURVE.belief(CURVE.posterior(runs_of(lambda _: passes, 8)))
    assert (found.above if passes else found.below) > 0.95


def test_at_the_border_the_pass_rate_is_the_level() -> None:
    curve = PsychometricCurve([0.0, 0.25, 1.0], level=0.9)
    at = int(np.argmin(np.abs(curve.borders - 0.25)))
    assert curve.passes[1, at] == pytest.approx(np.full(len(SCALES) * len(ENDS), 0.9))
    assert (np.diff(curve.passes[:, at, :], axis=0) < 0.0).all()


def entropy(p: Array) -> float:
    return float(-(p[p > 0.0] * np.log(p[p > 0.0])).sum())


def test_the_next_run_is_the_one_that_says_most() -> None:
    """Compared with the definition: how much less is not known of the border after the answer, on average."""
    posterior = CURVE.posterior([(5, True), (20, True), (40, False), (30, True), (33, False)])
    gains = []
    for passes in CURVE.passes:
        left = 0.0
        for answer in (posterior * passes, posterior * (1.0 - passes)):
            chance = answer.sum()
            left += chance * entropy(answer.sum(axis=1) / chance)
        gains.append(entropy(posterior.sum(axis=1)) - left)
    assert CURVE.most_informative(posterior, 1) == [int(np.argmax(gains))]
    assert len(set(CURVE.most_informative(posterior, 4))) > 1  # one answer makes another at the same place less worth


def test_a_pass_rate_that_rises_is_noticed() -> None:
    rises = [(10, False)] * 6 + [(40, True)] * 6
    assert steepest_rise(rises) == Rise(10, 40, pytest.approx(1 / 924))
    island = [(0, True)] * 9 + [(20, False)] * 9 + [(40, True)] * 9
    assert steepest_rise(island)[:2] == (20, 40)
    for falls in ([(at, not passed) for at, passed in rises], [(10, False), (40, True)], []):  # two runs are chance
        assert steepest_rise(falls).chance > RISING


@pytest.mark.parametrize("table", [(0, 6, 6, 0), (2, 5, 4, 1), (5, 1, 1, 5), (0, 3, 0, 4)])
def test_the_exact_test_is_that_of_scipy(table: tuple[int, int, int, int]) -> None:
    from scipy.stats import fisher_exact

    passed, failed, passed_on, failed_on = table
    expected = fisher_exact([[passed, failed], [passed_on, failed_on]], alternative="less").pvalue
    assert _fisher(*table) == pytest.approx(expected)
