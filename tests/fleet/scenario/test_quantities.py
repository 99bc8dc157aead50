"""Quantities: exact, with units, and printed so that they read back to the same number."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from refusals import check_refusals

from fleet import quantities as q

FINITE = st.floats(allow_nan=False, allow_infinity=False)
WITH_UNIT = [d for d in q.DIMENSIONS if "" not in d.units]


@given(FINITE, st.sampled_from(q.DIMENSIONS))
def test_what_shows_reads_back(value: float, dimension: q.Dimension) -> None:
    """Every double, in every dimension: the text is the number, not nearly the number."""
    assert q.scalar(q.show(value, dimension), dimension) == value


@given(st.tuples(FINITE, FINITE, FINITE), st.sampled_from(q.DIMENSIONS))
def test_vectors_read_back(values: q.Vec3, dimension: q.Dimension) -> None:
    assert q.vector(q.show_vector(values, dimension), dimension) == values


@given(st.integers(-(2**63) + 1, 2**63 - 1))
def test_times_read_back(ns: int) -> None:
    assert q.time_ns(q.show_time(ns)) == ns


@given(st.decimals(-1000, 1000, places=4))
def test_units_scale_exactly(number: object) -> None:
    """0.1 m is 100 mm is 10 cm: the same double, which multiplying doubles would not give."""
    metres = Fraction(str(number))
    assert q.scalar(f"{number} m", q.LENGTH) == float(metres)
    assert q.scalar(f"{number} mm", q.LENGTH) == float(metres / 1000)
    assert q.parse(f"{number} cm", q.LENGTH) == (metres / 100,)


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("10 ms", 10_000_000),
        ("0.1 s", 100_000_000),
        ("0.3 us", 300),
        ("1e-3 s", 1_000_000),
        ("2 min", 120_000_000_000),
        ("1 h", 3_600_000_000_000),
        ("50ms", 50_000_000),
        (" 7  ns ", 7),
    ],
)
def test_times_are_whole_nanoseconds(text: str, ns: int) -> None:
    assert q.time_ns(text) == ns


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("180 deg", q.ANGLE, math.pi),
        ("1 kn", q.SPEED, 1852 / 3600),
        ("20 Nm", q.MOMENT, 20.0),
        ("20 N m", q.MOMENT, 20.0),
        ("0.3 1/s", q.RATE, 0.3),
        ("0.3 /s", q.RATE, 0.3),
        ("0.3/s", q.RATE, 0.3),
        (5, q.NUMBER, 5.0),
        (0.8, q.NUMBER, 0.8),
    ],
)
def test_reads_units(text: object, dimension: q.Dimension, value: float) -> None:
    assert q.scalar(text, dimension) == value


def test_reads_vectors() -> None:
    assert q.vector("5 1 5 m", q.LENGTH) == (5.0, 1.0, 5.0)
    assert q.vector("0.7 .1 -0 m/s", q.SPEED) == (0.7, 0.1, 0.0)
    assert q.vector("10 10 10", q.NUMBER) == (10.0, 10.0, 10.0)


def test_says_what_was_expected() -> None:
    """Of values as they stand in a file, each with what it should be."""
    readers = {dimension.name: partial(q.scalar, dimension=dimension) for dimension in q.DIMENSIONS}
    readers |= {"nanoseconds": q.time_ns, "ticks": q.ticks}
    check_refusals("scenario/quantities", lambda value, name: readers[name](yaml.safe_load(value)))


@pytest.mark.parametrize("dimension", WITH_UNIT, ids=lambda d: d.name)
def test_every_example_and_unit_reads(dimension: q.Dimension) -> None:
    q.scalar(dimension.example, dimension)
    for unit, size in dimension.units.items():
        assert q.parse(f"3 {unit}", dimension) == (3 * size,)
        if not unit[0].isdigit():  # "31/s" is thirty-one per second, not three
            assert q.parse(f"3{unit}", dimension) == (3 * size,)
        with pytest.raises(q.QuantityError, match="without a unit"):
            q.parse("3", dimension)


def test_ticks() -> None:
    assert q.ticks("10 ticks") == 10
    assert q.ticks("1 tick") == 1


@given(st.one_of(st.text(), st.text("0123456789.e+-ms /Ndeg", max_size=20)), st.sampled_from(q.DIMENSIONS))
def test_any_text_is_a_quantity_or_a_quantity_error(text: str, dimension: q.Dimension) -> None:
    for read in (lambda: q.scalar(text, dimension), lambda: q.vector(text, dimension), lambda: q.time_ns(text)):
        try:
            read()
        except q.QuantityError as error:
            assert 0 <= error.column <= len(text)  # noqa: PT017 - most texts are errors, all must be ours
