"""The clocks of the vehicles: what a scenario gives, or draws from its seed."""

from __future__ import annotations

from fleet.scenario.schema.clock import ClockSection
from netem.draws import normal
from netem.vehicle_clock import VehicleClock

DRIFT, OFFSET = "clock drift", "clock offset"  # purposes of draws
_MOST_DRIFT = 0.5  # s/s: what is drawn beyond it is this


def vehicle_clock(section: ClockSection, seed: int, i: int) -> VehicleClock:
    """The clock of vehicle i."""
    drift, offset = section.drift.mean, section.offset.mean
    if section.drift.sigma:
        drift += section.drift.sigma * normal(seed, DRIFT, i)
    if section.offset.sigma:
        offset += round(section.offset.sigma * normal(seed, OFFSET, i))
    return VehicleClock(offset, max(-_MOST_DRIFT, min(_MOST_DRIFT, drift)))


def draws(section: ClockSection) -> list[str]:
    """The purposes of the draws of a clock."""
    return [DRIFT] * bool(section.drift.sigma) + [OFFSET] * bool(section.offset.sigma)
