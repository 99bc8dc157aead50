"""The kinds of value that a scenario's keys take: how each is read from text, bounded, and printed back.

Each kind is an `Annotated` type, so that a model of `fleet.scenario.schema` has unit and bound beside the key, and
pydantic's errors arrive with the words and the column of the text at fault.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import radians
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    InstanceOf,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fleet import quantities as q
from fleet.quantities import vehicle_numbers
from netem.condition import Condition
from netem.curve import Curve
from netem.errors import SelectorError, TextError
from netem.grammar import parse_condition, print_condition
from netem.link_selector import parse_selector
from netem.propagation import decibels, power
from world.vectors import Vec3


class Section(BaseModel):
    """A mapping with known keys; with nothing in it, it may also be left empty."""

    # A schema is built when it is first needed, with all below it. So a default of a section is made by
    # `model_construct`: a call of the class would build one of its own.
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _empty(cls, value: Any) -> Any:
        return {} if value is None else value


def word_for(key: str) -> BeforeValidator:
    """A section may be given by the text of one of its keys alone."""
    return BeforeValidator(lambda value: {key: value} if isinstance(value, str) else value)


def section_of(annotation: Any) -> type[Section] | None:
    """The section inside an annotation such as `Below | None` or `list[InitialState]`."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    for argument in get_args(annotation):
        section = section_of(argument)
        if section is not None:
            return section
    return None


def loss_once(name: str) -> Any:
    """The key `loss` for a share that is lost, which was `name` once: old files are read, and logs keep the word."""
    return Field(alias="loss", validation_alias=AliasChoices("loss", name))


def mistake(message: str, column: int = 0, hint: str = "") -> PydanticCustomError:
    """An error that keeps its own words and the column within the text at fault."""
    return PydanticCustomError("mistake", "{message}", {"message": message, "column": column, "hint": hint})


def mistake_of(error: TextError) -> PydanticCustomError:
    """As `mistake`, for a text that could not be read. It keeps the error, whose words depend on what vehicles are
    called, which no reader of a value knows.
    """
    known = {"message": error.message, "column": error.column, "hint": error.hint, "error": error}
    return PydanticCustomError("mistake", "{message}", known)


def mistake_words(context: Mapping[str, Any], names: Sequence[str]) -> str:
    """The message of a mistake from its context, for vehicles with these names."""
    error = context.get("error")
    return error.in_names(names) if isinstance(error, SelectorError) else str(context["message"])


@dataclass(frozen=True)
class Text:
    """A value that is written as text: `read` takes what the YAML holds, `show` gives what `read` takes."""

    read: Callable[[Any], Any]
    show: Callable[[Any], Any]
    bound: Literal["any", "positive", "not negative"] = "any"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(
            self._validate, handler(source), serialization=core_schema.plain_serializer_function_ser_schema(self.show)
        )

    def _validate(self, value: Any) -> Any:
        try:
            result = self.read(value)
        except TextError as error:
            raise mistake_of(error) from None
        for number in result if isinstance(result, tuple) else (result,):
            if self.bound == "positive" and number <= 0:
                raise mistake(f"must be above 0, got {q.describe_value(value)}")
            if self.bound == "not negative" and number < 0:
                raise mistake(f"must be 0 or more, got {q.describe_value(value)}")
        return result


def _scalar(dimension: q.Dimension, bound: Literal["any", "positive", "not negative"] = "any") -> Text:
    return Text(lambda value: q.scalar(value, dimension), lambda value: q.show(value, dimension), bound)


def _vector(dimension: q.Dimension, bound: Literal["any", "positive", "not negative"] = "any") -> Text:
    return Text(lambda v: q.vector(v, dimension), lambda v: q.show_vector(v, dimension), bound)


def _curve(x: q.Dimension, y: q.Dimension) -> Text:
    return Text(lambda value: Curve(q.curve(value, x, y)), lambda curve: q.show_curve(curve.points, x, y))


def _scatter(value: Any) -> float:
    if value == "rayleigh":
        return 0.0
    if isinstance(value, str) and value.startswith("rician "):
        return power(q.scalar(value.removeprefix("rician "), q.LEVEL))
    raise q.QuantityError(f'expected "rayleigh", or "rician 6 dB", got {q.describe_value(value)}')


def _show_scatter(k: float) -> str:
    return f"rician {decibels(k)!r} dB" if k else "rayleigh"


def _show_ticks(number: int) -> str:
    return "1 tick" if number == 1 else f"{number} ticks"


def _condition(value: Any) -> Condition:
    if isinstance(value, str):
        return parse_condition(value)
    raise q.QuantityError(
        f'expected a link condition such as "delay 200ms 50ms loss 30%", got {q.describe_value(value)}'
    )


def _range_reader(dimension: q.Dimension, low: float, high: float, limits: str) -> Callable[[Any], float]:
    """A reader of numbers from `low` to `high`; `limits` are these two in the words of its error."""

    def read(value: Any) -> float:
        number = q.scalar(value, dimension)
        if not low <= number <= high:
            raise q.QuantityError(f"must be between {limits}, got {q.describe_value(value)}")
        return number

    return read


_probability = _range_reader(q.RATIO, 0.0, 1.0, "0 and 100 %")
_MOST_DRIFT = "-100000 and 100000 ppm"  # a tenth: no quartz is so bad, but borders are looked for
_drift = _range_reader(q.CLOCK_DRIFT, -0.1, 0.1, _MOST_DRIFT)
_spread = _range_reader(q.CLOCK_DRIFT, 0.0, 0.1, "0 and 100000 ppm")
_fraction = _range_reader(q.NUMBER, 0.0, 1.0, "0 and 1")
_pitch_limit = _range_reader(q.ANGLE, radians(10.0), radians(90.0), "10 and 90 deg")
_spreading = _range_reader(q.NUMBER, 1.0, 2.0, "1 (cylindrical) and 2 (spherical)")


def _clock_time(value: Any) -> int:
    ns = q.time_ns(value)
    if abs(ns) > _MOST_CLOCK_TIME:
        raise q.QuantityError(f"must be between -24 h and 24 h, got {q.describe_value(value)}")
    return ns


_MOST_CLOCK_TIME = 24 * 3600 * 10**9  # ns


def _bytes(value: Any) -> int:
    number = q.parse(value, q.SIZE)[0]
    if number.denominator != 1 or number > 10**9:
        raise q.QuantityError(f"{q.describe_value(value)} is not a whole number of bytes")
    return number.numerator


def _numbers(value: Any) -> str:
    vehicle_numbers(str(value))
    return re.sub(r"\s+", "", str(value))


def read_condition(value: Any) -> Condition:
    """A link's condition from its words, for a validator of pydantic."""
    try:
        return _condition(value)
    except TextError as error:
        raise mistake_of(error) from None


def _name(value: Any) -> str:
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,31}", str(value), re.ASCII):
        return str(value)
    raise q.QuantityError(f"expected a name of letters, digits, - and _, got {q.describe_value(value)}")


PositiveNumber = Annotated[float, Text(lambda value: q.scalar(value, q.NUMBER), float, "positive")]
Weights = Annotated[Vec3, _vector(q.NUMBER, "not negative")]
Length = Annotated[float, _scalar(q.LENGTH, "not negative")]
PositiveLength = Annotated[float, _scalar(q.LENGTH, "positive")]
Position = Annotated[Vec3, _vector(q.LENGTH)]
PlanPosition = Annotated[
    tuple[float, float], Text(lambda v: q.pair(v, q.LENGTH), lambda v: q.show_vector(v, q.LENGTH))
]  # north, east
SignedSpeed = Annotated[float, _scalar(q.SPEED)]
Speed = Annotated[float, _scalar(q.SPEED, "not negative")]
PositiveSpeed = Annotated[float, _scalar(q.SPEED, "positive")]
Velocity = Annotated[Vec3, _vector(q.SPEED)]
Speeds = Annotated[Vec3, _vector(q.SPEED, "not negative")]
Acceleration = Annotated[float, _scalar(q.ACCELERATION, "not negative")]
SignedAngle = Annotated[float, _scalar(q.ANGLE)]
Angle = Annotated[float, _scalar(q.ANGLE, "not negative")]
PitchLimit = Annotated[float, Text(_pitch_limit, lambda value: q.show(value, q.ANGLE))]
SignedAngularRate = Annotated[float, _scalar(q.ANGULAR_RATE)]
AngleWalk = Annotated[float, _scalar(q.ANGLE_WALK, "not negative")]
SampleRate = Annotated[float, _scalar(q.SAMPLE_RATE, "positive")]
AngularRate = Annotated[float, _scalar(q.ANGULAR_RATE, "not negative")]
Force = Annotated[float, _scalar(q.FORCE, "not negative")]
ForceVector = Annotated[Vec3, _vector(q.FORCE)]
Moment = Annotated[float, _scalar(q.MOMENT, "not negative")]
Mass = Annotated[float, _scalar(q.MASS)]
Inertia = Annotated[float, _scalar(q.INERTIA)]
Damping = Annotated[float, _scalar(q.DAMPING, "not negative")]
RotationDamping = Annotated[float, _scalar(q.ROTATION_DAMPING, "not negative")]
AnyMoment = Annotated[float, _scalar(q.MOMENT)]
Ratio = Annotated[float, _scalar(q.RATIO)]
PositiveAcceleration = Annotated[float, _scalar(q.ACCELERATION, "positive")]
Layers = Annotated[Vec3, _vector(q.NUMBER, "positive")]
Probability = Annotated[float, Text(_probability, lambda value: q.show(value, q.RATIO))]
BitRate = Annotated[float, _scalar(q.BIT_RATE, "positive")]
Frequency = Annotated[float, _scalar(q.FREQUENCY, "positive")]
Level = Annotated[float, _scalar(q.LEVEL)]
PositiveLevel = Annotated[float, _scalar(q.LEVEL, "positive")]
AirtimeCurve = Annotated[InstanceOf[Curve], _curve(q.SIZE, q.TIME)]
DeliveryCurve = Annotated[InstanceOf[Curve], _curve(q.LENGTH, q.RATIO)]
CaptureCurve = Annotated[InstanceOf[Curve], _curve(q.LEVEL, q.RATIO)]
Scatter = Annotated[float, Text(_scatter, _show_scatter)]  # power of the steady path over the scattered
Temperature = Annotated[float, _scalar(q.TEMPERATURE)]
Salinity = Annotated[float, _scalar(q.NUMBER)]
Bytes = Annotated[int, Text(_bytes, lambda value: f"{value} bytes", "positive")]
NoBytes = Annotated[int, Text(_bytes, lambda value: f"{value} bytes", "not negative")]  # none is allowed, too
Fraction = Annotated[float, Text(_fraction, float)]
Spreading = Annotated[float, Text(_spreading, float)]
Gain = Annotated[float, _scalar(q.RATE, "positive")]
Gains = Annotated[Vec3, _vector(q.RATE, "positive")]
Time = Annotated[int, Text(q.time_ns, q.show_time, "not negative")]
Period = Annotated[int, Text(q.time_ns, q.show_time, "positive")]
ClockDrift = Annotated[float, Text(_drift, lambda value: q.show(value, q.CLOCK_DRIFT))]
ClockSpread = Annotated[float, Text(_spread, lambda value: q.show(value, q.CLOCK_DRIFT))]
ClockTime = Annotated[int, Text(_clock_time, q.show_time)]
ClockTimeSpread = Annotated[int, Text(_clock_time, q.show_time, "not negative")]
Ticks = Annotated[int, Text(q.ticks, _show_ticks, "positive")]
TicksOrNever = Annotated[int, Text(q.ticks, _show_ticks, "not negative")]
Count = Annotated[int, Field(ge=0)]
StateName = Annotated[str, Text(_name, str)]
LinkCondition = Annotated[InstanceOf[Condition], Text(_condition, print_condition)]
LinkSelector = Annotated[str, Text(lambda value: str(parse_selector(str(value))), str)]
VehicleNumbers = Annotated[str, Text(_numbers, str)]
