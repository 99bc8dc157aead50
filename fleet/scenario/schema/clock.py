"""The clock of a vehicle: its drift and offset, given or drawn."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section


class DriftSection(Section):
    """How fast a clock gains: the same for all vehicles, or drawn for each from a normal distribution."""

    mean: v.ClockDrift = 0.0
    sigma: v.ClockSpread = 0.0


class OffsetSection(Section):
    """By how much a clock is ahead at the start, likewise."""

    mean: v.ClockTime = 0
    sigma: v.ClockTimeSpread = 0


def _mean(value: Any) -> Any:
    """A plain value stands for its mean alone."""
    return {"mean": value} if isinstance(value, str | int | float) and not isinstance(value, bool) else value


def _show(section: DriftSection | OffsetSection | None) -> Any:
    return section and (section.model_dump(exclude_defaults=True) if section.sigma else section.model_dump()["mean"])


class ClockSection(Section):
    """The clock that an agent and its modem go by; what is left out is 0, or as it is for all vehicles."""

    drift: Annotated[DriftSection | None, BeforeValidator(_mean), PlainSerializer(_show)] = None
    offset: Annotated[OffsetSection | None, BeforeValidator(_mean), PlainSerializer(_show)] = None
