"""Laws of vectors, defaults of a plant's set-up, and the edges of limits."""

from __future__ import annotations

import math
import sysconfig

import pytest
from hypothesis import given
from hypothesis import strategies as some

from world.config import PlantSetup
from world.plugins.error_place import is_in_library
from world.plugins.fence import numbers_of
from world.tumble import HYSTERESIS_RAD, LIMIT_RAD, tumbles
from world.vectors import ZERO, Vec3, dot, minus, move_along, perpendicular, plus, scale

NUMBERS = some.integers(-1000, 1000).map(float)  # whole ones, so that sums are exact
VECTORS = some.tuples(NUMBERS, NUMBERS, NUMBERS)


@given(VECTORS, VECTORS, VECTORS, NUMBERS)
def test_sums_and_products_are_linear(a: Vec3, b: Vec3, c: Vec3, factor: float) -> None:
    assert minus(plus(a, b), b) == a
    assert move_along(a, b, factor) == plus(a, scale(b, factor))
    assert dot(plus(a, b), c) == dot(a, c) + dot(b, c) == dot(c, a) + dot(c, b)
    assert dot(a, a) == sum(x * x for x in a)


@given(VECTORS, some.permutations((1.0, 0.0, 0.0)), some.sampled_from((1.0, -1.0)))
def test_what_is_across_has_no_part_along(a: Vec3, axis: list[float], sign: float) -> None:
    ahead = (sign * axis[0], sign * axis[1], sign * axis[2])
    across = perpendicular(a, ahead)
    assert dot(across, ahead) == 0.0
    assert plus(across, scale(ahead, dot(a, ahead))) == a


def test_a_tumble_ends_at_its_lower_limit_and_begins_beyond_the_upper() -> None:
    low = LIMIT_RAD - HYSTERESIS_RAD
    for theta, while_tumbled, before in ((low, False, False), (math.nextafter(low, 9.0), True, False)):
        assert tumbles(True, LIMIT_RAD, (theta, 0.0), (theta, 0.0), 0.01) is while_tumbled
        assert tumbles(False, LIMIT_RAD, (theta, 0.0), (theta, 0.0), 0.01) is before
    assert tumbles(False, LIMIT_RAD, (LIMIT_RAD, 0.0), (LIMIT_RAD, 0.0), 0.01) is False


def test_a_plant_starts_without_roll() -> None:
    setup = PlantSetup("own:Plant", {}, 0.0)
    assert (setup.phi0, setup.p0, setup.file) == (0.0, 0.0, "")


def test_files_of_libraries_and_frozen_modules_are_not_the_users() -> None:
    assert is_in_library(f"{sysconfig.get_path('stdlib')}/json/decoder.py")
    assert is_in_library("<frozen importlib._bootstrap>")
    assert not is_in_library("/home/me/law.py")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ((1, 2.5), [1.0, 2.5]),
        (range(3), [0.0, 1.0, 2.0]),
        ("12", []),
        ({1: 2}, []),
        ([1, "2"], []),
        (None, []),
        ([ZERO], []),
    ],
)
def test_numbers_of_an_answer(value: object, expected: list[float]) -> None:
    assert numbers_of(value) == expected
