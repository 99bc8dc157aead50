"""The laws of the vehicles: profiles, guidance, tracking, neighbours, and what differs per vehicle."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, PlainSerializer

from agents.config import Angles, Cost, Extrapolation, Method
from fleet.quantities import CLOCK_DRIFT, show, show_time
from fleet.scenario.schema.navigation import NavigationChoice
from fleet.scenario.schema.value_types import (
    Acceleration,
    ClockDrift,
    ClockSpread,
    ClockTime,
    ClockTimeSpread,
    Gain,
    Gains,
    Layers,
    Period,
    PlanPosition,
    PositiveAcceleration,
    PositiveLength,
    PositiveNumber,
    PositiveSpeed,
    Section,
    Speed,
    Time,
    Velocity,
    Weights,
    named,
)
from fleet.scenario.schema.vehicle import ModelErrorSection, VehicleSection

# --- clock
# The clock of a vehicle: its drift and offset, given or drawn.


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


# --- keep apart
# The section for keeping vehicles apart and out of cylinders: agents.laws.keep_apart.


class ObstacleSection(Section):
    """A vertical cylinder, from the surface to the bottom."""

    at: PlanPosition  # of its axis: north, east
    radius: PositiveLength


class KeepApartSection(Section):
    """A distance that vehicles keep from each other, and cylinders that they do not enter."""

    distance: PositiveLength
    obstacles: list[ObstacleSection] = []
    gain: Gain = 0.3  # of the barrier: how fast a distance may shrink for each metre that is left
    lag: Period = 1_000_000_000  # the longest time in which a velocity follows its command
    slew: PositiveAcceleration = 0.3  # per axis: how fast the filter changes the command
    acceleration: PositiveAcceleration = 0.5  # what a neighbour may do since it was heard
    speed: PositiveSpeed = 1.5  # likewise; and the limit of what the filter commands on each horizontal axis
    climb: PositiveSpeed = 0.1  # up or down, of any command: a third of the least speed, `tracking.u_floor`
    age_cap: Period = 2_000_000_000  # what is older is extrapolated no further, and its margin grows no more


class LawSection(Section):
    """A law by name, `package.module:Class` or entry point, and the parameters of a law of the user."""

    law: str
    parameters: dict[str, Any] | None = None


def _show_law(section: LawSection | None) -> Any:
    if section is None or section.parameters:
        return None if section is None else {"law": section.law, "parameters": section.parameters}
    return section.law


LawChoice = Annotated[LawSection, BeforeValidator(named), PlainSerializer(_show_law)]


class GuidanceSection(Section):
    """The guidance law, and what differs from the profile in its parameters (agents.config.GuidanceParams)."""

    law: str | None = None
    parameters: dict[str, Any] | None = None
    Q: Weights | None = None
    R1: Weights | None = None
    R2: Weights | None = None
    p: PositiveNumber | None = None
    K0: Gains | None = None
    k_min: Gain | None = None
    k_max: Gain | None = None
    rho_lo: Velocity | None = None
    rho_hi: Velocity | None = None
    qp_period: Period | None = None
    horizon: Period | None = None
    cost: Cost | None = None
    slew: Acceleration | None = None


class TrackingSection(Section):
    """The tracking law, and what differs from the profile in its parameters (agents.config.TrackingParams)."""

    law: str | None = None
    parameters: dict[str, Any] | None = None
    k_u: Gain | None = None
    k_q: Gain | None = None
    k_r: Gain | None = None
    k_theta: Gain | None = None
    k_psi: Gain | None = None
    a: Gain | None = None
    b_up: PositiveNumber | None = None
    b_down: PositiveNumber | None = None
    phi: Layers | None = None
    tau_f: Time | None = None
    angles: Angles | None = None
    u_floor: Speed | None = None
    rho_eps: Speed | None = None
    cos_eps: PositiveNumber | None = None
    u_eps: PositiveSpeed | None = None


class LocalizationSection(Section):
    """How ranges to others correct the position that the navigator believes."""

    method: Method
    gate: PositiveNumber = 10.83  # chi-square with 1 degree of freedom, 99.9 %
    mirror: bool = False  # keep the mirror image of the place as well, until ranges tell which it is


def _localization(value: Any) -> Any:
    """Localisation may be given by its method alone."""
    return {"method": value} if isinstance(value, str) else value


class AgentSection(Section):
    """A whole agent in place of the laws, and the clock and the localisation of the agent, whichever it is."""

    law: str | None = None
    parameters: dict[str, Any] | None = None
    clock: ClockSection | None = None
    localization: Annotated[LocalizationSection | None, BeforeValidator(_localization)] = None


def _show_agent(section: AgentSection | None) -> Any:
    if section is None:
        return None
    values = section.model_dump(exclude_none=True)
    return values["law"] if list(values) == ["law"] else values


AgentChoice = Annotated[AgentSection, BeforeValidator(named), PlainSerializer(_show_agent)]
Profile = Literal["paper", "consistent", "hardened", "remus100"]
GuidanceChoice = Annotated[GuidanceSection, BeforeValidator(named)]
TrackingChoice = Annotated[TrackingSection, BeforeValidator(named)]


class NeighboursSection(Section):
    """How an agent estimates the present state of a neighbour from its last message."""

    extrapolate: Extrapolation = "hold"
    age_cap: Time = 0  # the longest extrapolation; 0: no limit
    drop_after: Time = 0  # a neighbour that is silent for so long has weight 0 until its next message; 0: never


class VehicleOverrides(Section):
    """The sections that may differ for some vehicles."""

    agent: AgentChoice | None = None
    controller: LawChoice | None = None
    profile: Profile | None = None
    guidance: GuidanceChoice | None = None
    tracking: TrackingChoice | None = None
    neighbours: NeighboursSection | None = None
    vehicle: VehicleSection | None = None
    model_error: ModelErrorSection | None = None
    navigation: NavigationChoice | None = None
    external: bool | None = None  # the run does not start its agent
    knows_reference: bool | None = None

    @property
    def whole_agent(self) -> AgentSection | None:
        """The agent that is in place of the laws; None: there is none."""
        return None if self.agent is None or self.agent.law is None else self.agent

    @property
    def localization(self) -> LocalizationSection | None:
        """How it uses ranges; None: not at all."""
        return None if self.agent is None else self.agent.localization

    @property
    def clock(self) -> ClockSection | None:
        """The clock that is set; None: it is right."""
        return None if self.agent is None else self.agent.clock
