"""The sea: current and sensor noise."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, PlainSerializer

from fleet.scenario.schema.section import Section
from fleet.scenario.schema.value_types import Angle, AngularRate, Length, Period, Speed, Speeds, Velocity


class CurrentSection(Section):
    """An irrotational current, NED: constant, or with a first-order Gauss-Markov part."""

    mean: Velocity = (0.0, 0.0, 0.0)
    sigma: Speeds = (0.0, 0.0, 0.0)
    time_constant: Period = 60_000_000_000


def _current(value: Any) -> Any:
    """A current that is constant is its velocity alone."""
    return {"mean": value} if isinstance(value, str) else value


def _show_current(current: CurrentSection | None) -> Any:
    if current is None:
        return None
    values = current.model_dump()
    return values if any(current.sigma) else values["mean"]


Current = Annotated[CurrentSection, BeforeValidator(_current), PlainSerializer(_show_current)]


class SeaSection(Section):
    """The forces of the sea on every vehicle."""

    disturbance: Literal["none", "paper"] = "none"
    current: Current = CurrentSection()


class SensorsSection(Section):
    """Standard deviations of white noise on the navigation sensor; 0 is off."""

    position_noise: Length = 0.0
    angle_noise: Angle = 0.0
    velocity_noise: Speed = 0.0
    rate_noise: AngularRate = 0.0
