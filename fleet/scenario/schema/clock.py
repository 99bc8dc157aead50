"""The clock of a vehicle: its drift and offset, given or drawn."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from fleet.quantities import CLOCK_DRIFT, show, show_time
from fleet.scenario.schema.section import Section
from fleet.scenario.schema.value_types import ClockDrift, ClockSpread, ClockTime, ClockTimeSpread


class DriftSection(Section):
    """How fast a clock gains: the same for all vehicles, or drawn for each from a normal distribution."""

    mean: ClockDrift = 0.0
    sigma: ClockSpread = 0.0


class OffsetSection(Section):
    """By how much a clock is ahead at the start, likewise."""

    mean: ClockTime = 0
    sigma: ClockTimeSpread = 0


def _mean(value: Any) -> Any:
    """A plain value stands for its mean alone."""
    return {"mean": value} if isinstance(value, str | int | float) and not isinstance(value, bool) else value


def _show_drift(drift: DriftSection | None) -> Any:
    if drift is None or drift.sigma:
        return None if drift is None else drift.model_dump(exclude_defaults=True)
    return show(drift.mean, CLOCK_DRIFT)


def _show_offset(offset: OffsetSection | None) -> Any:
    if offset is None or offset.sigma:
        return None if offset is None else offset.model_dump(exclude_defaults=True)
    return show_time(offset.mean)


class ClockSection(Section):
    """The clock that an agent and its modem go by; what is left out is 0, or as it is for all vehicles."""

    drift: Annotated[DriftSection | None, BeforeValidator(_mean), PlainSerializer(_show_drift)] = None
    offset: Annotated[OffsetSection | None, BeforeValidator(_mean), PlainSerializer(_show_offset)] = None
