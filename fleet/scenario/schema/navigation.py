"""How the vehicles know where they are: exactly, by dead reckoning with fixes, or as a recorded error says."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from fleet.quantities import describe_value
from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section, mistake

DEFAULT_GRADE = "tactical"


class FixSection(Section):
    """Fixes of the horizontal position; what is left out has a default for each kind."""

    at: v.Position | None = None  # the beacon, or the middle of the beacons; usbl and lbl
    period: v.Period | None = None
    delay: v.Time | None = None  # from measurement to use
    loss: v.Probability | None = None
    noise: v.Length | None = None  # standard deviation on each axis, next to the beacon
    noise_per_distance: v.Ratio | None = None  # the part that grows with the distance; it adds up as a root of squares
    reach: v.PositiveLength | None = None  # greatest distance to the beacon; any
    depth: v.Length | None = None  # gps: below it there is none


class ExpectedCurrent(Section):
    """The filter's model of a current that it does not know: a first-order Gauss-Markov process."""

    sigma: v.Speed = 0.2
    time_constant: v.Period = 3_600_000_000_000


class NavigationSection(Section):
    """A vehicle's belief about its position; `navigation: ideal` in the file is `ideal` here."""

    ideal: bool = False
    grade: str | None = None  # grade of the instruments, shipped or a TOML file; default: tactical
    heading_rate: v.SampleRate | None = None
    heading_bias: v.Angle | None = None
    heading_noise: v.Angle | None = None
    heading_walk: v.AngleWalk | None = None
    gyro_rate: v.SampleRate | None = None
    gyro_bias: v.AngularRate | None = None
    gyro_walk: v.AngleWalk | None = None
    dvl_rate: v.SampleRate | None = None
    dvl_scale: v.Ratio | None = None
    dvl_noise: v.Speed | None = None
    dvl_altitude: v.Length | None = None
    depth_rate: v.SampleRate | None = None
    depth_bias: v.Length | None = None
    depth_noise: v.Length | None = None
    tilt: v.Angle | None = None
    start: v.Length | None = None  # standard deviation of the position on each axis at the start; 1 m
    bottom: v.PositiveLength | None = None  # depth of the floor; without it the DVL always sees it
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
    values = section and section.model_dump(exclude_none=True, exclude_unset=True)
    return "ideal" if section and section.ideal else values["grade"] if values and set(values) == {"grade"} else values


NavigationChoice = Annotated[NavigationSection, BeforeValidator(_read_navigation), PlainSerializer(_show_navigation)]
