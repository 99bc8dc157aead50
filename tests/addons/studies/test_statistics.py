"""Intervals against values from the literature, and their laws."""

from __future__ import annotations

from itertools import product
from math import inf, isnan, log, nan

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fleet.addons.studies.statistics import compare, levels, median, pass_rate


def test_the_interval_of_a_pass_rate_is_wilsons() -> None:
    found = pass_rate(17, 20)
    assert found.value == 0.85
    # (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n) with z = 1.959964
    assert (found.low, found.high) == pytest.approx((0.63958, 0.94763), abs=1e-5)
    assert all(map(isnan, pass_rate(0, 0)[:3]))


@given(st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_a_pass_rate_is_within_its_interval_and_the_interval_within_0_and_1(case: tuple[int, int]) -> None:
    passed, runs = case
    found = pass_rate(passed, runs)
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0
    assert pass_rate(2 * passed, 2 * runs).half < found.half


def test_the_interval_of_a_median_is_between_two_of_the_ordered_values() -> None:
    """Ranks as in tables of the sign test, such as Conover, Practical Nonparametric Statistics, 3rd ed., 3.1."""
    for runs, rank in {6: 1, 8: 1, 9: 2, 11: 2, 12: 3, 20: 6, 50: 18, 100: 40}.items():
        found = median([*range(runs, 0, -1), nan])
        assert (found.low, found.high, found.runs) == (rank, runs + 1 - rank, runs)
        assert found.level >= 0.95
    assert median(range(7)).level == 1 - 2 / 2**7
    assert median([2.0] * 7)[:4] == (2.0, 2.0, 2.0, 7)
    assert median([1.0, 2.0])[0] == 1.5
    assert isnan(median([nan]).value)


@pytest.mark.parametrize("runs", [1, 2, 3, 4, 5])
def test_fewer_than_six_values_have_no_interval_for_their_median(runs: int) -> None:
    found = median([1.0] * runs)
    assert found.value == 1.0
    assert all(map(isnan, (found.low, found.high, found.half, found.level)))


@pytest.mark.parametrize("runs", range(6, 12))
def test_the_level_of_a_median_is_exact(runs: int) -> None:
    """Around a true median of 0 all patterns of signs are equally likely, whatever the distribution."""
    held = 0
    for signs in product((-1.0, 1.0), repeat=runs):
        found = median([sign * (number + 1) for number, sign in enumerate(signs)])
        held += found.low <= 0.0 <= found.high
    assert held / 2**runs == pytest.approx(median(range(runs)).level)


@pytest.mark.parametrize("runs", [6, 7, 10, 15, 20])
def test_intervals_of_medians_hold_the_truth_as_often_as_they_say(runs: int) -> None:
    """Samples of a skewed distribution; a bootstrap held the truth in 87 % of samples of seven."""
    samples = np.random.default_rng(runs).exponential(size=(2000, runs)).tolist()
    found = list(map(median, samples))
    level = found[0].level
    held = sum(each.low <= log(2.0) <= each.high for each in found)
    assert held == pytest.approx(2000 * level, abs=4.0 * (2000 * level * (1.0 - level)) ** 0.5)


def test_levels_are_told_as_they_are() -> None:
    assert levels([median(range(6)), pass_rate(1, 2)]) == "95 to 96.9 %"
    assert levels([median(range(7)), median(range(3)), median(range(7))]) == "98.4 %"
    assert levels([median(range(5))]) == ""


def test_what_never_came_is_larger_than_every_number() -> None:
    found = median([1.0, 2.0, 3.0, 4.0, inf, inf, inf])
    assert found[:4] == (4.0, 1.0, inf, 7)
    assert median([1.0, inf]).value == inf
    assert median([1.0, inf, inf, inf, inf, inf, nan])[:3] == (inf, 1.0, inf)
    assert median([inf] * 6)[:4] == (inf, inf, inf, 6)


@example([58.72002990770883, 58.72002990770883, 1.0] * 2, 0)
@example([1e308] * 6, 0)
@given(st.lists(st.floats(0.1, 100.0), min_size=6, max_size=30), st.integers(0, 30))
def test_a_median_with_what_never_came_is_within_its_interval(values: list[float], never: int) -> None:
    found = median(values + [inf] * never)
    assert found.low <= found.value <= found.high
    assert (found.value == inf) == (never >= len(values))
    assert found.runs == len(values) + never


def test_a_median_between_what_never_came_on_either_side_is_even() -> None:
    """The median of the differences turns its sign when the two series change places."""
    assert median([-inf, inf]).value == 0.0
    found = median([-inf] * 4 + [inf] * 4)
    assert (found.low, found.value, found.high) == (-inf, 0.0, inf)
    assert median([-inf, -inf, 1.0]).value == -inf
    assert compare([inf] * 3 + [1.0] * 3, [1.0] * 3 + [inf] * 3).difference.value == 0.0


def test_values_that_are_the_same_but_for_one_have_an_interval() -> None:
    found = median([1.0] * 19 + [2.0])
    assert (found.low, found.high) == (1.0, 1.0)


def test_two_series_are_compared_in_pairs() -> None:
    first = [1.0, 5.0, 2.0, 8.0, 3.0, 9.0, nan]
    second = [1.5, 5.5, 2.5, 8.5, 3.5, 9.5, 1.0]  # always half more, which no comparison of the medians would show
    found = compare(first, second)
    assert found.difference[:3] == (0.5, 0.5, 0.5)
    assert found.difference.runs == 6
    assert found.better == 0.0
    assert found.p == pytest.approx(2 / 2**6)  # all six differences of one sign
    assert compare(first, first).better == 0.5
    settled = compare([1.0, inf, 3.0, 4.0, 5.0, 6.0], [inf, inf, 2.0, 3.0, 4.0, 5.0])
    assert settled.better == pytest.approx(4.5 / 6)
    assert settled.difference.runs == 6
    assert isnan(compare(first, first).p)


def test_fewer_than_six_pairs_that_differ_cannot_show_a_difference() -> None:
    """The least p of n pairs is 2 / 2^n."""
    first = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert compare(first, [value + 1.0 for value in first]).note == ""
    found = compare(first, [2.0, 3.0, 4.0, 5.0, 6.0, 6.0])
    assert isnan(found.p)
    assert found.note == "5 of 6 pairs differ: fewer than 6 cannot show a difference (p < 0.05)"
    assert compare([nan], [1.0]).note == "there is no pair of runs that both have the number"


def test_skewed_differences_with_median_0_are_seldom_a_difference() -> None:
    """Not more often than the level says, which a test that takes them for symmetric does not keep."""
    draw = np.random.default_rng(1)
    found = [compare([0.0] * 50, (draw.exponential(size=50) - np.log(2.0)).tolist()).p for _ in range(400)]
    assert np.mean(np.array(found) < 0.05) < 0.05
