"""Intervals against values from the literature, and their laws."""

from __future__ import annotations

from math import inf, isnan, nan

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fleet.study.statistics import compare, median, pass_rate


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


def test_a_median_has_an_interval_that_reads_the_same_each_time() -> None:
    values = [1.0, 2.0, 3.0, 4.0, 9.0, nan]
    found = median(values)
    assert (found.value, found.runs) == (3.0, 5)
    assert 1.0 <= found.low <= 3.0 <= found.high <= 9.0
    assert median(values) == found
    assert median([2.0] * 7) == (2.0, 2.0, 2.0, 7)
    assert median([1.0, 2.0])[0] == 1.5
    assert isnan(median([1.0, 2.0]).low)
    assert isnan(median([nan]).value)


def test_what_never_came_is_larger_than_every_number() -> None:
    found = median([1.0, 2.0, 3.0, 4.0, inf, inf, inf])
    assert (found.value, found.high, found.runs) == (4.0, inf, 7)
    assert 1.0 <= found.low <= 4.0
    assert median([1.0, inf]).value == inf
    assert median([1.0, inf, inf, inf, nan])[:3] == (inf, 1.0, inf)
    assert median([inf] * 5) == (inf, inf, inf, 5)


@example([58.72002990770883, 58.72002990770883, 1.0], 0)  # an end of the interval is rounded below the median
@given(st.lists(st.floats(0.1, 100.0), min_size=3, max_size=30), st.integers(0, 30))
def test_a_median_with_what_never_came_is_within_its_interval(values: list[float], never: int) -> None:
    found = median(values + [inf] * never)
    assert found.low <= found.value <= found.high
    assert (found.value == inf) == (never >= len(values))
    assert found.runs == len(values) + never


def test_values_that_are_the_same_but_for_one_have_an_interval() -> None:
    found = median([1.0] * 19 + [2.0])  # BCa is not defined here
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
