"""How the vehicles know where they are: exactly, by dead reckoning with fixes, or as a recorded error says."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from fleet.quantities import describe_value
from fleet.scenario.schema.value_types import (
    Angle,
    AngleWalk,
    AngularRate,
    Length,
    Period,
    Position,
    PositiveLength,
    Probability,
    Ratio,
    SampleRate,
    Section,
    Speed,
    Time,
    mistake,
)

DEFAULT_GRADE = "tactical"


class FixSection(Section):
    """Fixes of the horizontal position; what is left out has a default for each kind."""

    at: Position | None = None  # the beacon, or the middle of the beacons; usbl and lbl
    period: Period | None = None
    delay: Time | None = None  # from measurement to use
    loss: Probability | None = None
    noise: Length | None = None  # standard deviation on each axis, next to the beacon
    noise_per_distance: Ratio | None = None  # and what comes to it, as a root of squares
    reach: PositiveLength | None = None  # greatest distance to the beacon; any
    depth: Length | None = None  # gps: below it there is none


class ExpectedCurrent(Section):
    """The filter's model of a current that it does not know: a first-order Gauss-Markov process."""

    sigma: Speed = 0.2
    time_constant: Period = 3_600_000_000_000


class NavigationSection(Section):
    """A vehicle's belief about its position; `navigation: ideal` in the file is `ideal` here."""

    ideal: bool = False
    grade: str | None = None  # of the instruments, shipped or a TOML file; tactical
    heading_rate: SampleRate | None = None
    heading_bias: Angle | None = None
    heading_noise: Angle | None = None
    heading_walk: AngleWalk | None = None
    gyro_rate: SampleRate | None = None
    gyro_bias: AngularRate | None = None
    gyro_walk: AngleWalk | None = None
    dvl_rate: SampleRate | None = None
    dvl_scale: Ratio | None = None
    dvl_noise: Speed | None = None
    dvl_altitude: Length | None = None
    depth_rate: SampleRate | None = None
    depth_bias: Length | None = None
    depth_noise: Length | None = None
    tilt: Angle | None = None
    start: Length | None = None  # standard deviation of the position on each axis at the start; 1 m
    bottom: PositiveLength | None = None  # depth of the floor; without it the DVL always sees it
    current: ExpectedCurrent | None = None
    gps: FixSection | None = None
    usbl: FixSection | None = None
    lbl: FixSection | None = None
    trace: str | None = None  # a CSV file, or its content: the navigation error of a real vehicle


def _read_navigation(value: Any) -> Any:
    """The model's form of the section, which may be one word in the file."""
    if isinstance(value, str):
        if value == "ideal":
            return {"ideal": True}
        return {"grade": DEFAULT_GRADE if value == "dead-reckoning" else value}
    if value == {}:
        return {"grade": DEFAULT_GRADE}
    if isinstance(value, dict) and "ideal" in value:
        raise mistake('write "navigation: ideal" for vehicles that know where they are, which then is nothing else')
    if not isinstance(value, (dict, Section)):
        known = '"ideal", "dead-reckoning", a grade'
        raise mistake(f"expected a mapping, or {known}, got {describe_value(value)}")
    return value


def _show_navigation(section: NavigationSection | None) -> Any:
    """The file's form of the section."""
    if section is None or section.ideal:
        return None if section is None else "ideal"
    values = section.model_dump(exclude_none=True, exclude_unset=True)
    return values["grade"] if set(values) == {"grade"} else values


NavigationChoice = Annotated[NavigationSection, BeforeValidator(_read_navigation), PlainSerializer(_show_navigation)]
