"""A fix by ultra-short baseline: without errors it is where the modem is, and its errors are as large as it says."""

from __future__ import annotations

from math import pi, sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.modems.usbl import RANGE_SIGMA, measure_fix

LENGTHS = st.floats(-3000.0, 3000.0)


@given(st.tuples(LENGTHS, LENGTHS, LENGTHS), st.integers(0, 1000))
def test_without_errors_of_angles_it_is_the_place_but_for_the_range(away: tuple[float, ...], number: int) -> None:
    """The inverse of the way to range and angles. The range keeps its own error, along the line of sight."""
    north, east, down = away
    far = sqrt(sum(length * length for length in away))
    fix = measure_fix(away, far, 0.0, 1, (1, 2, number))
    assert abs(fix.range_m - far) <= 6.0 * RANGE_SIGMA and 0.0 <= fix.bearing <= 2.0 * pi
    for found, true in zip(fix.enu, (east, north, -down), strict=True):
        assert found == pytest.approx(true, abs=6.0 * RANGE_SIGMA + 1e-6)


def test_the_errors_are_as_large_as_they_say() -> None:
    sigma, count = 0.02, 4000
    fixes = [measure_fix((1000.0, 0.0, 0.0), 1000.0, sigma, 1, (1, 2, n)) for n in range(count)]
    bearings = [(fix.bearing + pi) % (2.0 * pi) - pi for fix in fixes]
    for errors, expected in (
        (bearings, sigma),
        ([fix.elevation for fix in fixes], sigma),
        ([fix.range_m - 1000.0 for fix in fixes], RANGE_SIGMA),
    ):
        assert sqrt(sum(error * error for error in errors) / count) == pytest.approx(expected, rel=0.05)


def test_a_measurement_is_drawn_once() -> None:
    one, again, other = (measure_fix((10.0, 20.0, 5.0), 23.0, 0.1, 1, (1, 2, n)) for n in (7, 7, 8))
    assert one == again != other
