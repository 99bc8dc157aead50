"""What a scenario file may say: every key, its meaning, its unit, its default.

The models hold validated values in SI units (times: integer ns) and print themselves with units. What needs
two keys at once is checked in `fleet.rules`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from agents.config import Cost, Extrapolation
from fleet.fields import (
    Acceleration,
    Angle,
    AngularRate,
    Count,
    Force,
    Gain,
    Gains,
    Length,
    LinkCondition,
    LinkSelector,
    Moment,
    Period,
    Position,
    PositiveLength,
    PositiveNumber,
    PositiveSpeed,
    SignedAngle,
    SignedAngularRate,
    SignedSpeed,
    Speed,
    Ticks,
    Time,
    Velocity,
    Weights,
    mistake,
)
from fleet.quantities import describe, show_time
from netem.grammar import print_condition
from world.config import DEFAULT_SUBSTEPS


class Section(BaseModel):
    """A mapping with known keys; with nothing in it, it may also be left empty."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _empty(cls, value: Any) -> Any:
        return {} if value is None else value


class ReferenceSection(Section):
    """The trajectory that the fleet follows: the paper's eta_1^d(t) = start + velocity t."""

    start: Position  # NED: north, east, down
    velocity: Velocity


class FormationSection(Section):
    """Where each vehicle belongs, relative to the reference: `offsets`, or a named `shape`."""

    offsets: list[Position] | None = None  # p_1, p_2, ...; Delta_ij = p_i - p_j
    shape: Literal["grid"] | None = None
    spacing: PositiveLength | None = None  # of the shape; 10 m


class _Followers:
    """`all`, or a list of numbers; a plain union would report a mistake in the list once per alternative."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_wrap_validator_function(
            self._validate,
            handler.generate_schema(list[int]),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda value: value),
        )

    @staticmethod
    def _validate(value: Any, numbers: Callable[[Any], list[int]]) -> Any:
        if value == "all":
            return value
        if isinstance(value, list):
            return numbers(value)
        raise mistake(f'expected "all" or a list of vehicle numbers such as [1, 3], got {describe(value)}')


class GraphSection(Section):
    """Who hears whom: `edges`, or a named `shape`; and who follows the reference itself."""

    shape: Literal["path", "ring"] | None = None
    ahead: PositiveNumber | None = None  # a_(i,i-1) of the shape; 1
    behind: PositiveNumber | None = None  # a_(i,i+1) of the shape; 1
    edges: dict[str, PositiveNumber] | None = None  # "1->2": a_21, vehicle 2 hears vehicle 1
    reference: Annotated[list[int] | Literal["all"], _Followers()] = "all"  # who has b_i = 1; the others have 0


class InitialState(Section):
    """One vehicle at t = 0."""

    position: Position
    pitch: SignedAngle = 0.0
    yaw: SignedAngle = 0.0
    surge: SignedSpeed = 0.0
    sway: SignedSpeed = 0.0
    heave: SignedSpeed = 0.0
    pitch_rate: SignedAngularRate = 0.0
    yaw_rate: SignedAngularRate = 0.0


class Scatter(Section):
    """Every vehicle near its offset: x and y uniform within the scatter, z below the offset by at most it."""

    scatter: Length
    surge: SignedSpeed = 0.0


class VehicleSection(Section):
    """What the actuators can do; commands are clipped to it."""

    surge_force: Force = 20.0
    pitch_moment: Moment = 20.0
    yaw_moment: Moment = 20.0


class SeaSection(Section):
    disturbance: Literal["none", "paper"] = "none"
    current: Velocity = (0.0, 0.0, 0.0)  # NED, constant and irrotational


class SensorsSection(Section):
    """Standard deviations of white noise on the navigation sensor; 0 is off."""

    position_noise: Length = 0.0
    angle_noise: Angle = 0.0
    velocity_noise: Speed = 0.0
    rate_noise: AngularRate = 0.0


class GuidanceSection(Section):
    """What differs from the profile in consensus guidance and its gain QP (agents.config.GuidanceParams)."""

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
    """What differs from the profile in the tracking controller (agents.config.TrackingParams)."""

    k_u: Gain | None = None
    k_q: Gain | None = None
    k_r: Gain | None = None
    k_theta: Gain | None = None
    k_psi: Gain | None = None
    a: Gain | None = None
    b_up: PositiveNumber | None = None
    b_down: PositiveNumber | None = None
    tau_f: Time | None = None
    u_floor: Speed | None = None
    rho_eps: Speed | None = None
    cos_eps: PositiveNumber | None = None
    u_eps: PositiveSpeed | None = None


class NeighboursSection(Section):
    """How an agent estimates where a neighbour is now from what it heard last."""

    extrapolate: Extrapolation = "hold"


class NetworkSection(Section):
    """The network between the agents; `network: ideal` in the file is `ideal` here."""

    ideal: bool = False
    period: Period = 100_000_000  # one round: every agent sends once per period
    links: dict[LinkSelector, LinkCondition] = {}  # the last that matches a link wins


class LogSection(Section):
    """How often each group of topics is logged; every packet of every link always is."""

    every: Ticks = 1
    pose: Ticks | None = None
    state: Ticks | None = None
    nav: Ticks | None = None
    command: Ticks | None = None
    guidance: Ticks | None = None
    control: Ticks | None = None
    error: Ticks | None = None


class Below(Section):
    """The largest value over all vehicles stays below a limit from a time to the end."""

    below: PositiveLength
    after: Time = 0


class AtMost(Section):
    at_most: Count


class ChecksSection(Section):
    """What decides whether a run passes."""

    formation_error: Below | None = None  # |eta_i - eta_i^d|
    consensus_error: Below | None = None  # |e_i| from true positions
    qp_infeasible: AtMost | None = None
    ledger: Literal["balanced"] | None = None
    middleware_loss: AtMost | None = None


def _on_death(value: Any) -> Any:
    if value in ("continue", "restart"):
        raise mistake(f'"{value}" comes with the fault language', hint='use "abort"')
    return value


def _network(value: Any) -> Any:
    if value == "ideal":
        return {"ideal": True}
    if isinstance(value, dict):
        if "ideal" in value:
            raise mistake('write "network: ideal" for the network without latency')
        return value
    raise mistake(f'expected a mapping with a period and links, or "ideal", got {describe(value)}')


def _show_network(network: NetworkSection) -> Any:
    if network.ideal:
        return "ideal"
    links = {selector: print_condition(condition) for selector, condition in network.links.items()}
    return {"period": show_time(network.period)} | ({"links": links} if links else {})


def _initial(value: Any) -> Any:
    if isinstance(value, list):
        return {"vehicles": value}
    if isinstance(value, dict):
        return {"scatter": value}
    raise mistake(f"expected a list with one entry per vehicle, or a scatter, got {describe(value)}")


class InitialSection(Section):
    """Either the state of each vehicle or a scatter; the file holds just the one that applies."""

    vehicles: list[InitialState] | None = None
    scatter: Scatter | None = None


def _show_initial(initial: InitialSection) -> Any:
    entries = initial.vehicles if initial.vehicles is not None else initial.scatter
    if entries is None:
        return None
    if isinstance(entries, list):
        return [entry.model_dump(exclude_defaults=True) for entry in entries]
    return entries.model_dump(exclude_defaults=True)


def _title(value: Any) -> Any:
    if isinstance(value, str) and not (value.strip() and value.isprintable() and len(value) <= 200):
        raise mistake("expected one line of at most 200 printable characters")
    return value


class PhysicsSection(Section):
    """How finely the sea is integrated."""

    substeps: Annotated[int, Field(ge=1, le=100)] = DEFAULT_SUBSTEPS  # RK4 steps per tick


class ScenarioSpec(Section):
    """The whole file."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]  # also names the run directory
    title: Annotated[str, BeforeValidator(_title)]  # what one learns from it, in one line
    vehicles: Annotated[int, Field(ge=1, le=1000)]
    duration: Period
    tick: Period = 10_000_000  # the control period Ts
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    on_death: Annotated[Literal["abort"], BeforeValidator(_on_death)] = "abort"
    stall_timeout: Period = 30_000_000_000  # wall time without progress that ends the run
    reference: ReferenceSection
    formation: FormationSection
    graph: GraphSection
    initial: Annotated[InitialSection, BeforeValidator(_initial), PlainSerializer(_show_initial)]
    vehicle: VehicleSection = VehicleSection()
    sea: SeaSection = SeaSection()
    sensors: SensorsSection = SensorsSection()
    controller: Literal["nboc"] = "nboc"
    profile: Literal["paper", "consistent", "hardened"] = "paper"
    guidance: GuidanceSection = GuidanceSection()
    tracking: TrackingSection = TrackingSection()
    neighbours: NeighboursSection = NeighboursSection()
    network: Annotated[NetworkSection, BeforeValidator(_network), PlainSerializer(_show_network)]
    physics: PhysicsSection = PhysicsSection()
    log: LogSection = LogSection()
    checks: ChecksSection = ChecksSection()
