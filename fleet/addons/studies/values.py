"""The values that a study varies: a key, or a name of a template, and its values as text.

    VALUES := VALUE , VALUE ...          a list: `nboc, bc`, `0 %, 10 %, 30 %`, `{a: 1}, {a: 2}`
            | LOW..HIGH / STEP           `0 %..90 %/10 %`; the high end counts if a step meets it
            | LOW..HIGH / COUNT          so many values at equal distances: `0..2 s/9`; a count has no unit
            | LOW..HIGH lin|log COUNT    at equal distances, or at equal ratios: `100 ms..2 s log 8`
            | LOW..HIGH random COUNT     drawn, every value equally likely; `random log COUNT`: every ratio
            | LOW..HIGH latin COUNT      a Latin hypercube over all keys with it; `latin log COUNT`
            | LOW..HIGH/STEP random ...  drawn, then rounded to whole steps above LOW: `100 ms..2 s/10 ms random 20`

A unit that only one end has holds for both. Values in a range have at most six significant digits.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from math import exp, log
from typing import Literal, NamedTuple

from fleet.addons.studies.errors import StudyError
from fleet.errors import printable
from fleet.quantities import DIMENSIONS
from fleet.scenario.text.yaml_writer import inline
from netem.grammar import RATE_UNITS
from netem.parsing import LONGEST_NUMBER, NUMBER, exact_number, nearest

MOST_VALUES = 100_000  # of one key
DIGITS = 6
_LONGEST_RANGE = 200  # characters; the pattern takes a time that grows with the square of it

_SIZES = [dict(dimension.units) for dimension in DIMENSIONS] + [{unit: Fraction(n) for unit, n in RATE_UNITS.items()}]
_UNITS = sorted({unit for sizes in _SIZES for unit in sizes if unit}, key=len, reverse=True)
_UNIT = "|".join(map(re.escape, _UNITS))


def _quantity(name: str) -> str:
    return rf"(?P<{name}>{NUMBER.pattern})(?:\s*(?P<{name}_unit>{_UNIT}))?"


_RANGE = re.compile(
    rf"\s*{_quantity('low')}\s*\.\.\s*{_quantity('high')}\s*"
    rf"(?:/\s*{_quantity('step')}\s*)?(?:(?P<how>[a-z][a-z ]*?)\s+(?P<count>\d{{1,9}}))?\s*",
    re.ASCII,
)
_SINGLE = re.compile(_quantity("value"), re.ASCII)
_KEY = re.compile(r"[^\s=]+")

How = Literal["grid", "random", "latin"]
_HOWS: dict[str, tuple[How, bool]] = {
    "lin": ("grid", False),
    "log": ("grid", True),
    "random": ("random", False),
    "random log": ("random", True),
    "latin": ("latin", False),
    "latin log": ("latin", True),
}


class AxisValue(NamedTuple):
    """One value: the text that is set, and its number in the axis' unit, if it is a number."""

    text: str
    number: float | None = None


@dataclass(frozen=True, slots=True)
class Axis:
    key: str  # a key of the scenario, such as `network.links.*.loss`, or a name in a template
    unit: str = ""  # unit of the numbers. Empty: they have none, or the values are words
    values: tuple[AxisValue, ...] = ()  # the values in order. Empty: they are still to be drawn
    how: How = "grid"  # `grid`: the listed values. `random`, `latin`: `count` values are drawn between `low` and `high`
    low: float = 0.0  # the ends of the range
    high: float = 0.0
    count: int = 0  # number of values to draw
    scale: Literal["lin", "log"] = "lin"  # `log`: equal ratios are equally likely, or equally far apart
    step: float = 0.0  # drawn values are rounded to whole steps above `low`. With 0 they are not rounded
    option: str = "--vary"  # the command-line option that varies the key

    @property
    def sampled(self) -> bool:
        return self.how != "grid"

    @property
    def numeric(self) -> bool:
        return self.sampled or all(value.number is not None for value in self.values)

    def at(self, share: float) -> AxisValue:
        """The value at a share, from 0 to 1, of the way from the low end to the high one."""
        if self.scale == "log":
            number = exp(log(self.low) + share * (log(self.high) - log(self.low)))
        else:
            number = self.low + share * (self.high - self.low)
        if self.step:
            most = int((self.high - self.low) / self.step + 1e-9)
            number = self.low + min(round((number - self.low) / self.step), most) * self.step
        return _value(number, self.unit)


def parse_axis(text: str, *, fine: int = 0) -> Axis:
    """The axis that `KEY=VALUES` describes. `fine`: if above 0, a range needs no step. It gets a round step, with at
    least this number of steps. Raises StudyError: it has no key, or its values are none."""
    return axis(*key_and_values(text), fine=fine)


def key_and_values(text: str) -> tuple[str, str]:
    """Both sides of `KEY=VALUES`. Raises StudyError: there is no key."""
    key, equals, values = text.partition("=")
    if not equals or not _KEY.fullmatch(key.strip()):
        raise StudyError(f"expected KEY=VALUES such as 'network.links.*.loss=0 %..90 %/10 %', got '{text[:80]}'")
    return key.strip(), values.strip()


def axis(key: str, text: str, *, fine: int = 0) -> Axis:
    """The axis of a key and its values as text; see `parse_axis`. Raises StudyError."""
    if not _KEY.fullmatch(key):
        raise StudyError(f"expected a key such as network.links.*.loss, got '{printable(key[:80])}'")
    try:
        if ".." in text and not any(mark in text for mark in "{[\"'"):
            return _range(key, text, fine)
        return _listed_axis(key, text)
    except StudyError as error:
        raise StudyError(f"{key}={text.strip()[:80]}: {error}") from None


def values_text(values: object) -> str:
    """The text of VALUES that are given as a text, a number or a list of them."""
    if isinstance(values, Iterable) and not isinstance(values, str | Mapping):
        return ", ".join(_value_text(value, listed=True) for value in values)
    return _value_text(values)


def _value_text(value: object, *, listed: bool = False) -> str:
    if isinstance(value, bool | Mapping | list | None):
        return inline(value)
    text = str(value)
    return f'"{text}"' if listed and "," in text and not re.search("[\\[{\"']", text) else text


def _listed_axis(key: str, text: str) -> Axis:
    texts = [part.strip() for part in _split(text)]
    if not any(texts):
        raise StudyError("expected values, got nothing")
    if not all(texts):
        raise StudyError("there is no value between two commas, or behind the last")
    if len(set(texts)) < len(texts):
        twice, _ = Counter(texts).most_common(1)[0]
        raise StudyError(f"the value {twice[:40]} is given twice")
    matches = [_SINGLE.fullmatch(text) for text in texts]
    unit = next((match["value_unit"] for match in matches if match and match["value_unit"]), "")
    values = []
    for text, match in zip(texts, matches, strict=True):
        number = exact_number(match["value"]) if match else None
        factor = _factor(match["value_unit"] or "", unit) if match else None
        if number is None or factor is None:  # values of several kinds are words
            return Axis(key, "", tuple(map(AxisValue, texts)))
        values.append(AxisValue(text, _float(number * factor)))
    return Axis(key, unit, tuple(values))


def _range(key: str, text: str, fine: int) -> Axis:
    match = _RANGE.fullmatch(text) if len(text) <= _LONGEST_RANGE else None
    if match is None:
        hint = "write LOW..HIGH/STEP, LOW..HIGH log COUNT, or a list; units as in 100 ms"
        raise StudyError(f"expected a range such as 0 %..90 %/10 % or 100 ms..2 s log 8; {hint}")
    unit = match["low_unit"] or match["high_unit"] or ""
    low = _number(match, "low", unit)
    high = _number(match, "high", unit)
    if low >= high:
        raise StudyError("the low end must be below the high end")
    if match["how"]:
        made = _counted_axis(key, unit, low, high, match["how"], int(match["count"]))
        return made if match["step"] is None else _round_axis(made, _step(match, unit, low, high))
    if match["step"] is None and fine:
        small = _round_step(high - low, fine)
        count = int((high - low) / small) + 1
        return Axis(key, unit, tuple(_value(_float(low + k * small), unit) for k in range(count)))
    if match["step"] is None:
        raise StudyError("how many values? write a step as in 0 %..90 %/10 %, or a count as in 0 %..90 % lin 10")
    if unit and not match["step_unit"]:
        step = exact_number(match["step"])
        if step is None or step.denominator != 1 or step < 2:
            raise StudyError(f"a step needs a unit, as in /10 {unit}; a count is a whole number from 2 on")
        return _counted_axis(key, unit, low, high, "lin", int(step))
    step = _step(match, unit, low, high)
    count = (high - low) // step + 1
    if count > MOST_VALUES:
        raise StudyError(f"{count} values are too many: at most {MOST_VALUES} are possible")
    return Axis(key, unit, tuple(_value(_float(low + k * step), unit) for k in range(count)))


def _step(match: re.Match[str], unit: str, low: Fraction, high: Fraction) -> Fraction:
    step = _number(match, "step", unit)
    if step <= 0:
        raise StudyError("a step must be above 0")
    if step > high - low:
        raise StudyError(f"the step is larger than the range; lin {match['step']} means so many values")
    return step


def _round_axis(drawn: Axis, step: Fraction) -> Axis:
    if not drawn.sampled:
        raise StudyError("what is drawn can be rounded to a step: random or latin; lin and log say where each value is")
    return replace(drawn, step=_float(step))


def _round_step(span: Fraction, least: int) -> Fraction:
    """The largest step of 1, 2 or 5 times a power of ten that meets the end after `least` steps or a few times more."""
    steps = (size * Fraction(10) ** power for power in range(9, -10, -1) for size in (5, 2, 1))
    meeting = (step for step in steps if least <= span / step <= 10 * least and (span / step).denominator == 1)
    return next(meeting, span / least)


def _counted_axis(key: str, unit: str, low: Fraction, high: Fraction, how: str, count: int) -> Axis:
    words = " ".join(how.split())
    if words not in _HOWS:
        hint = nearest(words, _HOWS) or f"known: {', '.join(_HOWS)}"
        raise StudyError(f'unknown kind of range "{words[:40]}"; {hint}')
    kind, logarithmic = _HOWS[words]
    if not 2 <= count <= MOST_VALUES:
        raise StudyError(f"a count must be from 2 to {MOST_VALUES}, got {count}")
    if logarithmic and low <= 0:
        raise StudyError("a range at equal ratios must begin above 0")
    made = Axis(key, unit, (), kind, _float(low), _float(high), count, "log" if logarithmic else "lin")
    if logarithmic and made.low == 0.0:
        raise StudyError("the low end is too small")
    if made.sampled:
        return made
    values = tuple(made.at(k / (count - 1)) for k in range(count))
    return Axis(key, unit, values, scale=made.scale)


def _number(match: re.Match[str], name: str, unit: str) -> Fraction:
    number = exact_number(match[name])
    own = match[f"{name}_unit"] or unit
    factor = _factor(own, unit)
    if number is None:
        raise StudyError(f"a number may have {LONGEST_NUMBER} characters at most")
    if factor is None:
        raise StudyError(f'"{own}" and "{unit}" are no units of the same')
    return number * factor


def _factor(own: str, unit: str) -> Fraction | None:
    """How much of `unit` one `own` is; None if they do not measure the same."""
    if own == unit:
        return Fraction(1)
    for sizes in _SIZES:
        if own in sizes and unit in sizes:
            return sizes[own] / sizes[unit]
    return None


def _float(number: Fraction) -> float:
    try:
        return float(number)
    except OverflowError:
        raise StudyError("the number is too large") from None


def _value(number: float, unit: str) -> AxisValue:
    text = f"{number:.{DIGITS}g}"
    if "e" in text:  # 1e-07: as people write it
        text = f"{float(text):.20f}".rstrip("0").rstrip(".")
    return AxisValue(f"{text} {unit}".rstrip(), float(text))


def _split(text: str) -> Iterator[str]:
    depth, quote, begin = 0, "", 0
    for at, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character in "{[(":
            depth += 1
        elif character in ")]}":
            depth -= 1
        elif character == "," and depth == 0:
            yield text[begin:at]
            begin = at + 1
    yield text[begin:]
