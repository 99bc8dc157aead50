"""Numbers with units as text ("50 ms", "5 1 5 m", "20 deg"), read exactly and printed so that they read back.

Times become integer nanoseconds and never pass through a binary float, so that "10 ms" is 10 000 000 ns and
the question whether one period divides another has an exact answer. Everything else becomes the double
nearest to the exact decimal value in SI units (angles: radians).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import lru_cache
from typing import Any

from netem.errors import SelectorError, TextError
from netem.parsing import exact_number, nearest
from world.vectors import Vec3

_MAX_NS = 2**63 - 1  # stamps are signed 64-bit nanoseconds on the wire and in the log


@dataclass(frozen=True, slots=True)
class Dimension:
    """A physical dimension: its name with article, an example, and each unit's size in SI units.

    The first unit is the one values are printed in, provided that the text reads back to the same number; the
    SI unit, of size 1, always does.
    """

    name: str
    example: str
    units: dict[str, Fraction]

    def vector_example(self, count: int) -> str:
        number, _, unit = self.example.partition(" ")
        return f"{number}{' 0' * (count - 1)} {unit}".rstrip()


def _units(**sizes: str | int) -> dict[str, Fraction]:
    return {name: Fraction(size) for name, size in sizes.items()}


_DEG = Fraction(math.pi) / 180  # so that "180 deg" is exactly math.pi

TIME = Dimension("a time", "50 ms", _units(s=1, ms="1/1000", us="1/1000000", ns="1/1000000000", min=60, h=3600))
LENGTH = Dimension("a length", "0.1 m", _units(m=1, mm="1/1000", cm="1/100", km=1000))
SPEED = Dimension("a speed", "0.7 m/s", {"m/s": Fraction(1), "cm/s": Fraction(1, 100), "kn": Fraction(1852, 3600)})
ACCELERATION = Dimension("an acceleration", "0.3 m/s^2", {"m/s^2": Fraction(1), "m/s2": Fraction(1)})
ANGLE = Dimension("an angle", "20 deg", {"deg": _DEG, "rad": Fraction(1)})
ANGULAR_RATE = Dimension("an angular rate", "5 deg/s", {"deg/s": _DEG, "rad/s": Fraction(1), "deg/h": _DEG / 3600})
ANGLE_WALK = Dimension(
    "a random walk of an angle", "0.1 deg/sqrt(h)", {"deg/sqrt(h)": _DEG / 60, "rad/sqrt(s)": Fraction(1)}
)
SAMPLE_RATE = Dimension("a rate", "5 Hz", _units(Hz=1, kHz=1000))
FORCE = Dimension("a force", "20 N", _units(N=1, mN="1/1000", kN=1000))
MOMENT = Dimension("a moment", "20 N m", {"N m": Fraction(1), "Nm": Fraction(1), "kN m": Fraction(1000)})
RATE = Dimension("a gain per second", "0.3 1/s", {"1/s": Fraction(1), "/s": Fraction(1)})
MASS = Dimension("a mass", "10 kg", _units(kg=1, g="1/1000", t=1000))
INERTIA = Dimension("a moment of inertia", "3 kg m^2", {"kg m^2": Fraction(1), "kg m2": Fraction(1)})
DAMPING = Dimension("a linear damping", "1.1 kg/s", {"kg/s": Fraction(1), "N s/m": Fraction(1)})
ROTATION_DAMPING = Dimension(
    "a rotational damping", "0.2 kg m^2/s", {"kg m^2/s": Fraction(1), "N m s": Fraction(1), "N m s/rad": Fraction(1)}
)
RATIO = Dimension("a relative error", "10 %", {"%": Fraction(1, 100), "": Fraction(1)})
TICKS = Dimension("a number of ticks", "10 ticks", _units(ticks=1, tick=1))
BIT_RATE = Dimension("a bit rate", "80 bit/s", {"bit/s": Fraction(1), "kbit/s": Fraction(1000)})
FREQUENCY = Dimension("a frequency", "25 kHz", _units(kHz=1000, Hz=1))
LEVEL = Dimension("a level", "190 dB", _units(dB=1))
SIZE = Dimension("a size", "32 bytes", _units(bytes=1, byte=1))
AGE = Dimension(
    "an age", "7 days", _units(days=86_400, day=86_400, d=86_400, weeks=604_800, week=604_800, h=3600, min=60, s=1)
)
CLOCK_DRIFT = Dimension(
    "a clock drift", "20 ppm", {"ppm": Fraction(1, 10**6), "ppb": Fraction(1, 10**9), "s/s": Fraction(1)}
)
TEMPERATURE = Dimension("a temperature", "10 degC", _units(degC=1))
NUMBER = Dimension("a number", "0.8", {"": Fraction(1)})

DIMENSIONS = (
    TIME, LENGTH, SPEED, ACCELERATION, ANGLE, ANGULAR_RATE, FORCE, MOMENT, RATE, MASS, INERTIA, DAMPING,
    ROTATION_DAMPING, ANGLE_WALK, TICKS, BIT_RATE, FREQUENCY, LEVEL, SIZE, CLOCK_DRIFT, TEMPERATURE, RATIO, NUMBER,
)  # fmt: skip


class QuantityError(TextError):
    """A text, or a value in its place, that is not the quantity it should be."""


class UnknownVehicle(SelectorError, QuantityError):
    """A number, or a text in its place, that no vehicle has."""

    def __init__(self, message: str, got: str, hint: str = "") -> None:
        super().__init__(message, hint=hint)
        self.got = got

    def _in_names(self, names: Sequence[str]) -> str:
        return f"there is no node {self.got}: the nodes are {', '.join(names)}"


def parse(value: Any, dimension: Dimension, count: int = 1) -> tuple[Fraction, ...]:
    """`count` exact numbers in SI units.

    `value`: what the YAML holds: text, or a bare number where the dimension has no unit. Raises QuantityError: not a
    finite quantity of this dimension and length.
    """
    example = dimension.vector_example(count)
    expected = f'expected {_phrase(dimension, count)} such as "{example}"'
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise QuantityError(f"{expected}, got {describe_value(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise QuantityError(f"{expected}, got {describe_value(value)}: every number must be finite")
    text = value if isinstance(value, str) else repr(value)
    numbers, unit, column = _split(text)
    if not numbers:
        raise QuantityError(f"{expected}, got {describe_value(value)}")
    factor = _factor(unit, dimension, expected, text, column)
    if len(numbers) != count:
        given = f"{len(numbers)} number{'s' if len(numbers) > 1 else ''}"
        raise QuantityError(f'{expected}, got {given} in "{_short(text)}"')
    return tuple(number * factor for number in numbers)


def scalar(value: Any, dimension: Dimension) -> float:
    """One quantity as a float in SI units. Raises QuantityError."""
    return _float(parse(value, dimension)[0])


def vector(value: Any, dimension: Dimension) -> Vec3:
    """Three numbers with one unit, such as `5 1 5 m`, as floats in SI units. Raises QuantityError."""
    x, y, z = parse(value, dimension, 3)
    return _float(x), _float(y), _float(z)


def pair(value: Any, dimension: Dimension) -> tuple[float, float]:
    """Two numbers with one unit, such as `5 1 m`, as floats in SI units. Raises QuantityError."""
    x, y = parse(value, dimension, 2)
    return _float(x), _float(y)


def time_ns(value: Any) -> int:
    """A time in whole nanoseconds. Raises QuantityError."""
    ns = parse(value, TIME)[0] * 10**9
    if ns.denominator != 1:
        raise QuantityError(f'"{_short(str(value))}" is not a whole number of nanoseconds')
    if abs(ns.numerator) > _MAX_NS:
        raise QuantityError(f'"{_short(str(value))}" is longer than 292 years, the longest time there is')
    return ns.numerator


def ticks(value: Any) -> int:
    """A whole number of ticks. Raises QuantityError."""
    number = parse(value, TICKS)[0]
    if number.denominator != 1 or abs(number.numerator) > _MAX_NS:
        raise QuantityError(f'"{_short(str(value))}" is not a whole number of ticks')
    return number.numerator


def show(value: float, dimension: Dimension) -> str:
    """The text of a value in SI units, in the dimension's first unit that reads back to the same double."""
    return show_vector((value,), dimension)


def show_vector(values: tuple[float, ...], dimension: Dimension) -> str:
    """Like `show`, for several numbers with one unit."""
    for unit, size in dimension.units.items():
        # Twelve digits are what people write; only the SI unit needs, and gets, all seventeen.
        numbers = [v if size == 1 else float(f"{v / float(size):.12g}") for v in values]
        if not all(math.isfinite(number) for number in numbers):
            continue
        text = f"{' '.join(repr(number).removesuffix('.0') for number in numbers)} {unit}".rstrip()
        if tuple(_float(number) for number in parse(text, dimension, len(values))) == tuple(values):
            return text
    raise AssertionError(f"{dimension.name} has no SI unit")


def curve(value: Any, x: Dimension, y: Dimension) -> tuple[tuple[float, float], ...]:
    """Points such as `12 m 95 %, 24 m 70 %`, one after the other or one per line, in SI units.

    Raises QuantityError: not at least two points, or x does not ascend.
    """
    example = f"{x.example} {y.example}"
    if not isinstance(value, str):
        raise QuantityError(f'expected points such as "{example}, ...", got {describe_value(value)}')
    points: list[tuple[float, float]] = []
    for item in re.split(r"\s*,\s*|\s*\n\s*", value.strip(", \n")):
        match = re.fullmatch(r"\s*([-+.\deE]+)\s*([^\s\d.+-]\S*)\s+(.*)", item)
        if match is None:
            raise QuantityError(f'expected a point such as "{example}", got {describe_value(item.strip())}')
        point = scalar(f"{match[1]} {match[2]}", x), scalar(match[3], y)
        if points and point[0] <= points[-1][0]:
            raise QuantityError(f'points must ascend: "{_short(item.strip())}" follows {show(points[-1][0], x)}')
        points.append(point)
    if len(points) < 2:
        raise QuantityError(f'expected at least two points such as "{example}, ...", got {describe_value(value)}')
    return tuple(points)


def show_curve(points: tuple[tuple[float, float], ...], x: Dimension, y: Dimension) -> str:
    """The inverse of `curve`."""
    return ", ".join(f"{show(a, x)} {show(b, y)}" for a, b in points)


def show_time(ns: int) -> str:
    """The text of a time, exactly, in the largest of s, ms, us and ns that does not make it less than 1."""
    for unit, size in (("s", 10**9), ("ms", 10**6), ("us", 10**3)):
        if abs(ns) >= size or ns == 0:
            return f"{(Decimal(ns) / size).normalize():f} {unit}"
    return f"{ns} ns"


def describe_value(value: Any) -> str:
    """A YAML value in words, for an error."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value) if len(repr(value)) < 40 else "a very long number"
    if isinstance(value, str):
        return f'"{_short(value)}"'
    return "a mapping" if isinstance(value, dict) else "a list" if isinstance(value, (list, tuple)) else "it"


@lru_cache(4096)  # the scenarios that ship, and the runs of a study, say the same few texts again and again
def _split(text: str) -> tuple[tuple[Fraction, ...], str, int]:
    """Leading numbers, the unit that follows, and the unit's column."""
    numbers: list[Fraction] = []
    at = 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        end = at
        while end < len(text) and not text[end].isspace():
            end += 1
        number = exact_number(text[at:end])
        if number is None:
            glued = _number_before_unit(text[at:end])  # "50ms"
            if glued is not None and text[at:end] not in ("1/s",):
                numbers.append(glued[0])
                at += glued[1]
            break
        numbers.append(number)
        at = end
    return tuple(numbers), " ".join(text[at:].split()), at


def _number_before_unit(word: str) -> tuple[Fraction, int] | None:
    """The number at the start of a word such as `50ms`, and its length."""
    for length in range(min(len(word), 40), 0, -1):
        number = exact_number(word[:length])
        if number is not None:
            return (number, length) if not word[length : length + 1].isdigit() else None
    return None


def _factor(unit: str, dimension: Dimension, expected: str, text: str, column: int) -> Fraction:
    if unit in dimension.units:
        return dimension.units[unit]
    if "" in dimension.units:
        raise QuantityError(f'{expected}, got "{_short(text)}"', column)
    if not unit:
        raise QuantityError(f'{expected}, got "{_short(text)}" without a unit')
    for other in DIMENSIONS:
        if unit in other.units:
            raise QuantityError(f'{expected}, got {other.name}, "{_short(text)}"', column)
    known = ", ".join(dimension.units)
    hint = nearest(unit, dimension.units) or f"units of {dimension.name}: {known}"
    raise QuantityError(f'{expected}, got the unknown unit "{_short(unit)}"', column, hint)


def _phrase(dimension: Dimension, count: int) -> str:
    if count == 1:
        return dimension.name
    return f"{dimension.name} for {'x and y' if count == 2 else 'x, y and z'}"


def _float(number: Fraction) -> float:
    try:
        return float(number)
    except OverflowError:
        raise QuantityError("the number is too large") from None


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


def vehicle_numbers(text: str) -> list[int]:
    """The vehicles that a text names.

    Args:
        text: numbers and ranges, such as `2-4, 7`.

    Returns:
        Their numbers, in the order of the text.

    Raises:
        UnknownVehicle: it is no such text.
        QuantityError: it names none.
    """
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,4})\s*(?:-\s*(\d{1,4})\s*)?", part, re.ASCII)
        if match is None:
            wanted = 'expected vehicle numbers such as "3" or "2-4, 7", got'
            raise UnknownVehicle(f"{wanted} {describe_value(text)}", text.strip()[:40])
        numbers += range(int(match[1]), int(match[2] or match[1]) + 1)
    if not numbers:
        raise QuantityError(f"names no vehicle: {describe_value(text)}")
    return numbers


def unknown_vehicle(number: int, vehicles: int) -> UnknownVehicle:
    """The mistake that a number is, if there are only so many vehicles."""
    return UnknownVehicle(f"there is no vehicle {number}: the vehicles are 1 to {vehicles}", str(number))


def vehicle_name(vehicle: int, names: Sequence[str] = ()) -> str:
    """The number of a vehicle, or its name if it is a node."""
    return names[vehicle - 1] if names else str(vehicle)


def vehicle_names(vehicles: Sequence[int], names: Sequence[str] = ()) -> str:
    """`vehicle 3`, or `vehicles 3, 4 and 5 more`; with the names of nodes, `auv3, auv4 and 5 more`."""
    shown = ", ".join(vehicle_name(i, names) for i in vehicles[:8])
    more = f" and {len(vehicles) - 8} more" if len(vehicles) > 8 else ""
    noun = "" if names else "vehicles " if len(vehicles) > 1 else "vehicle "
    return f"{noun}{shown}{more}"
