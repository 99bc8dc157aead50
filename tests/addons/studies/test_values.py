"""The text of what a study varies: what it stands for, and what is wrong with it in words."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.values import Axis, AxisValue, axis, parse_axis, values_text


@pytest.mark.parametrize(
    ("text", "unit", "values"),
    [
        ("loss=0 %..30 %/10 %", "%", ["0 %", "10 %", "20 %", "30 %"]),
        ("loss=0..30 %/20 %", "%", ["0 %", "20 %"]),
        ("delay=100 ms..2 s lin 3", "ms", ["100 ms", "1050 ms", "2000 ms"]),
        ("delay=1 s..100 s log 3", "s", ["1 s", "10 s", "100 s"]),
        ("delay=0..2 s/3", "s", ["0 s", "1 s", "2 s"]),  # a count: it has no unit
        ("speed=0.1 m/s..0.5 m/s/0.2 m/s", "m/s", ["0.1 m/s", "0.3 m/s", "0.5 m/s"]),
        ("gain=0.5 1/s..1 1/s/0.25 1/s", "1/s", ["0.5 1/s", "0.75 1/s", "1 1/s"]),
        ("rate=1 kbit..2 kbit/500 bit", "kbit", ["1 kbit", "1.5 kbit", "2 kbit"]),
        ("n=4..8/2", "", ["4", "6", "8"]),
        ("controller=nboc, bc", "", ["nboc", "bc"]),
        ("delay=100 ms, 1 s", "ms", ["100 ms", "1 s"]),
        ("links={a: 1, b: 2}, {a: 3}", "", ["{a: 1, b: 2}", "{a: 3}"]),
        ("tiny=0..1e-7 lin 2", "", ["0", "0.0000001"]),
    ],
)
def test_values(text: str, unit: str, values: list[str]) -> None:
    found = parse_axis(text)
    assert ([value.text for value in found.values], found.unit) == (values, unit)


def test_numbers_are_in_the_unit_of_the_axis() -> None:
    assert [value.number for value in parse_axis("d=100 ms, 1 s").values] == [100.0, 1000.0]
    assert [value.number for value in parse_axis("l=0.5, 10 %").values] == [50.0, 10.0]  # a ratio may have no unit
    assert not parse_axis("c=nboc, 1 s").numeric  # of several kinds: words


def test_drawn_values_have_a_range_and_a_count() -> None:
    found = parse_axis("network.links.*.loss=0 %..50 % latin log 7".replace("0 %..", "1 %.."))
    assert found == Axis("network.links.*.loss", "%", (), "latin", 1.0, 50.0, 7, "log")
    assert found.sampled and found.numeric
    assert found.at(0.0) == AxisValue("1 %", 1.0)
    assert found.at(1.0) == AxisValue("50 %", 50.0)
    assert found.at(0.5) == AxisValue("7.07107 %", 7.07107)


@pytest.mark.parametrize("how", ["random 5", "latin log 5"])
def test_drawn_values_are_rounded_to_steps(how: str) -> None:
    """A scenario refuses a period that is not whole ticks. Steps begin at the low end; none is above the high one."""
    found = parse_axis(f"network.period=100 ms..2 s/30 ms {how}")
    shares = [k / 1000 for k in range(1001)]
    numbers = {found.at(share).number for share in shares}
    assert numbers == {float(100 + 30 * k) for k in range(64)}
    assert found.at(1.0).text == "1990 ms"


@given(st.integers(-999, 999), st.integers(1, 50), st.integers(1, 40))
def test_a_range_has_every_step_and_both_ends(low: int, step: int, count: int) -> None:
    found = parse_axis(f"k={low} mm..{low + step * count} mm/{step} mm")
    assert [value.number for value in found.values] == [low + step * k for k in range(count + 1)]


@given(st.text(max_size=40))
def test_any_text_is_values_or_an_error(text: str) -> None:
    try:
        found = axis("key", text)
    except StudyError:
        return
    assert found.sampled or found.values


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ("0 %..9 %/1 %", "0 %..9 %/1 %"),
        (7, "7"),
        ([1.0, 2.5], "1.0, 2.5"),
        ([True, None], "true, null"),
        (["0 %", "10 %"], "0 %, 10 %"),
        ([{"a": 1, "b": "x"}, [1, 2]], "{a: 1, b: x}, [1, 2]"),
        (["delay 1s, loss 2%", "{a: 1, b: 2}"], '"delay 1s, loss 2%", {a: 1, b: 2}'),
        ((n for n in (1, 2)), "1, 2"),
    ],
)
def test_values_of_a_list_are_values_as_text(values: object, text: str) -> None:
    assert values_text(values) == text
