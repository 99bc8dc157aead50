"""The clocks of the vehicles: what a scenario gives, or draws from its seed."""

from __future__ import annotations

from fleet.scenario.schema.clock import ClockSection, DriftSection, OffsetSection
from fleet.scenario.schema.spec import ScenarioSpec, sections
from netem.draws import normal
from netem.vehicle_clock import VehicleClock

DRIFT, OFFSET = "clock drift", "clock offset"  # purposes of draws
_MOST_DRIFT = 0.5  # s/s: what is drawn beyond it is this


def clock_sections(spec: ScenarioSpec) -> list[ClockSection]:
    """The clocks that a scenario sets: for all vehicles, and for some."""
    return [agent.clock for _, agent in sections(spec, "agent") if agent is not None and agent.clock is not None]


def vehicle_clock(section: ClockSection, seed: int, i: int) -> VehicleClock:
    """The clock of vehicle i."""
    drift, offset = section.drift or DriftSection(), section.offset or OffsetSection()
    rho, theta = drift.mean, offset.mean
    if drift.sigma:
        rho += drift.sigma * normal(seed, DRIFT, i)
    if offset.sigma:
        theta += round(offset.sigma * normal(seed, OFFSET, i))
    return VehicleClock(theta, max(-_MOST_DRIFT, min(_MOST_DRIFT, rho)))
