"""The laws of the vehicles: profiles, guidance, tracking, neighbours, and what differs per vehicle."""

from __future__ import annotations

from datetime import UTC, datetime
from math import inf
from time import monotonic
from typing import Annotated, Any, Literal

from pydantic import PlainSerializer, model_validator

from agents.config import Angles, Astern, Cost, Extrapolation, Method, Solver
from fleet.scenario import value_types as v
from fleet.scenario.schema.clock import ClockSection
from fleet.scenario.schema.gateway import GatewaySection
from fleet.scenario.schema.navigation import NavigationChoice
from fleet.scenario.schema.vehicle import ModelErrorSection, VehicleSection
from fleet.scenario.value_types import Section, mistake, word_for


class LawSection(Section):
    """A law by name, `package.module:Class` or entry point, and the parameters of a law of the user."""

    law: str
    parameters: dict[str, Any] | None = None


def _show_law(section: LawSection | None) -> Any:
    return section and (section.model_dump() if section.parameters else section.law)


LawChoice = Annotated[LawSection, word_for("law"), PlainSerializer(_show_law)]


class GuidanceSection(Section):
    """The guidance law, and what differs from the profile in its parameters (agents.config.GuidanceParams)."""

    law: str | None = None
    parameters: dict[str, Any] | None = None
    Q: v.Weights | None = None
    R1: v.Weights | None = None
    R2: v.Weights | None = None
    p: v.PositiveNumber | None = None
    K0: v.Gains | None = None
    k_min: v.Gain | None = None
    k_max: v.Gain | None = None
    rho_lo: v.Velocity | None = None
    rho_hi: v.Velocity | None = None
    qp_period: v.Period | None = None
    horizon: v.Period | None = None
    cost: Cost | None = None
    solver: Solver | None = None  # the exact formula alone, or PIQP beside it: the gain is the same
    slew: v.Acceleration | None = None


class TrackingSection(Section):
    """The tracking law, and what differs from the profile in its parameters (agents.config.TrackingParams)."""

    law: str | None = None
    parameters: dict[str, Any] | None = None
    k_u: v.Gain | None = None
    k_q: v.Gain | None = None
    k_r: v.Gain | None = None
    k_theta: v.Gain | None = None
    k_psi: v.Gain | None = None
    a: v.Gain | None = None
    b_up: v.PositiveNumber | None = None
    b_down: v.PositiveNumber | None = None
    phi: v.Layers | None = None
    tau_f: v.Time | None = None
    angles: Angles | None = None
    astern: Astern | None = None  # what is steered below 0.1 m/s of surge
    u_floor: v.Speed | None = None
    rho_eps: v.Speed | None = None
    cos_eps: v.PositiveNumber | None = None
    u_eps: v.PositiveSpeed | None = None


class LocalizationSection(Section):
    """How ranges to others correct the position that the navigator believes."""

    method: Method
    gate: v.PositiveNumber = 10.83  # chi-square with 1 degree of freedom, 99.9 %
    mirror: bool = False  # keep the mirror image of the place as well, until ranges tell which it is
    nis: bool = False  # report the signal `guidance.nis`


class _Now:
    """The date and time in UTC, to a second: the same for all vehicles of a scenario that is read."""

    _SAME_S = 10.0

    def __init__(self) -> None:
        self._read_s, self._text = -inf, ""

    def __str__(self) -> str:
        if monotonic() - self._read_s > self._SAME_S:
            now = datetime.now(UTC)  # noqa: TID251  # what a user asks for by `epoch: now`; the run is given the number
            self._read_s, self._text = monotonic(), now.isoformat(timespec="seconds").removesuffix("+00:00")
        return self._text


_now = _Now()


class AgentSection(Section):
    """A whole agent in place of the laws, and the clock and the localisation of the agent, whichever it is."""

    law: str | None = None
    parameters: dict[str, Any] | None = None
    clock: ClockSection | None = None
    localization: Annotated[LocalizationSection | None, word_for("method")] = None

    @model_validator(mode="before")
    @classmethod
    def _read_program(cls, value: Any) -> Any:
        """`{program: FILE, ...}` is the law `program:FILE`, with all else as its parameters."""
        if not isinstance(value, dict) or "program" not in value:
            return value
        own = {key: each for key, each in value.items() if key in cls.model_fields}
        more = {key: each for key, each in value.items() if key not in {*own, "program"}}
        program = value["program"]
        if "law" in own:
            raise mistake("agent.program and agent.law are both given", hint="a program is in place of a law")
        if isinstance(program, list) and len(program) == 2:  # `[node, x.js]`
            more, program = {"interpreter": program[0]} | more, program[1]
        if isinstance(program, dict) and [*program] == ["module"] and isinstance(program["module"], str):
            more = {"module": program["module"]} | more
            program = program["module"].replace(".", "/") + ".py"
        if not isinstance(program, str):
            raise mistake(f"agent.program is {program!r}", hint="give a file, [INTERPRETER, FILE] or {module: NAME}")
        given = own.get("parameters") or {}
        if twice := sorted(given.keys() & more.keys()):
            raise mistake(f"agent.{twice[0]} and agent.parameters.{twice[0]} are the same", hint="give one of them")
        parameters = given | more
        if parameters.get("epoch") == "now":  # the scenario that a run keeps has the moment, so that it can be repeated
            parameters["epoch"] = str(_now)
        return own | {"law": f"program:{program}"} | ({"parameters": parameters} if parameters else {})


def _show_agent(section: AgentSection | None) -> Any:
    values = section and section.model_dump(exclude_none=True)
    return values["law"] if values and list(values) == ["law"] else values


AgentChoice = Annotated[AgentSection, word_for("law"), PlainSerializer(_show_agent)]
Profile = Literal["paper", "consistent", "hardened", "remus100"]
GuidanceChoice = Annotated[GuidanceSection, word_for("law")]
TrackingChoice = Annotated[TrackingSection, word_for("law")]


class NeighboursSection(Section):
    """How an agent estimates the present state of a neighbour from its last message."""

    extrapolate: Extrapolation = "hold"
    age_cap: v.Time = 0  # the longest extrapolation; 0: no limit
    drop_after: v.Time = 0  # a neighbour that is silent for so long has weight 0 until its next message; 0: never


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
    gateway: GatewaySection | None = None  # its agent is a real computer, for which the run starts `fleet agent`
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
