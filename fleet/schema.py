"""What a scenario file may say: every key, its meaning, its unit, its default.

The models hold validated values in SI units (times: integer ns) and print themselves with units. What needs two
keys at once is checked in `fleet.rules`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, InstanceOf, PlainSerializer
from pydantic_core import PydanticCustomError

from agents.config import Cost, Extrapolation
from fleet import quantities as q
from netem.config import Condition
from netem.grammar import GrammarError, parse_condition, parse_selector, print_condition

Vec3 = q.Vec3
Bound = Literal["any", "positive", "not negative"]


def mistake(message: str, column: int = 0, hint: str = "") -> PydanticCustomError:
    """An error that keeps its own words and the column within the text at fault."""
    return PydanticCustomError("mistake", "{message}", {"message": message, "column": column, "hint": hint})


def _reader(read: Callable[[Any], Any], bound: Bound = "any") -> BeforeValidator:
    def validate(value: Any) -> Any:
        try:
            result = read(value)
        except (q.QuantityError, GrammarError) as error:
            raise mistake(error.message, error.column, error.hint) from None
        for number in result if isinstance(result, tuple) else (result,):
            if (bound == "positive" and number <= 0) or (bound == "not negative" and number < 0):
                word = "above 0" if bound == "positive" else "0 or more"
                raise mistake(f"must be {word}, got {q.describe(value)}")
        return result

    return BeforeValidator(validate)


def _scalar(dimension: q.Dimension, bound: Bound = "any") -> tuple[BeforeValidator, PlainSerializer]:
    return (
        _reader(lambda value: q.scalar(value, dimension), bound),
        PlainSerializer(lambda value: q.show(value, dimension)),
    )


def _vector(dimension: q.Dimension, bound: Bound = "any") -> tuple[BeforeValidator, PlainSerializer]:
    return (
        _reader(lambda value: q.vector(value, dimension), bound),
        PlainSerializer(lambda value: q.show_vector(value, dimension)),
    )


def _condition(value: Any) -> Condition:
    if not isinstance(value, str):
        raise q.QuantityError(
            f'expected a link condition such as "delay 200ms 50ms loss 30%", got {q.describe(value)}'
        )
    return parse_condition(value)


def _selector(value: Any) -> str:
    return str(parse_selector(str(value)))


Number = Annotated[float, *_scalar(q.NUMBER)]
PositiveNumber = Annotated[float, *_scalar(q.NUMBER, "positive")]
Weights = Annotated[Vec3, *_vector(q.NUMBER, "not negative")]
Length = Annotated[float, *_scalar(q.LENGTH, "not negative")]
PositiveLength = Annotated[float, *_scalar(q.LENGTH, "positive")]
Position = Annotated[Vec3, *_vector(q.LENGTH)]
Speed = Annotated[float, *_scalar(q.SPEED)]
NoisySpeed = Annotated[float, *_scalar(q.SPEED, "not negative")]
Velocity = Annotated[Vec3, *_vector(q.SPEED)]
Slew = Annotated[float, *_scalar(q.ACCELERATION, "not negative")]
Angle = Annotated[float, *_scalar(q.ANGLE)]
AngleNoise = Annotated[float, *_scalar(q.ANGLE, "not negative")]
AngularRate = Annotated[float, *_scalar(q.ANGULAR_RATE)]
RateNoise = Annotated[float, *_scalar(q.ANGULAR_RATE, "not negative")]
Force = Annotated[float, *_scalar(q.FORCE, "not negative")]
Moment = Annotated[float, *_scalar(q.MOMENT, "not negative")]
Gain = Annotated[float, *_scalar(q.RATE, "positive")]
Gains = Annotated[Vec3, *_vector(q.RATE, "positive")]
Time = Annotated[int, _reader(q.time_ns, "not negative"), PlainSerializer(q.show_time)]
Period = Annotated[int, _reader(q.time_ns, "positive"), PlainSerializer(q.show_time)]
Ticks = Annotated[
    int, _reader(q.ticks, "positive"), PlainSerializer(lambda n: "1 tick" if n == 1 else f"{n} ticks")
]
LinkCondition = Annotated[
    InstanceOf[Condition], _reader(_condition), PlainSerializer(print_condition, return_type=str)
]
Count = Annotated[int, Field(ge=0)]


class Section(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class ReferenceSection(Section):
    """The trajectory that the fleet follows: the paper's eta_1^d(t) = start + velocity t."""

    start: Position  # NED: north, east, down
    velocity: Velocity


class FormationSection(Section):
    """Where each vehicle belongs, relative to the reference: `offsets`, or a named `shape`."""

    offsets: list[Position] | None = None  # p_1, p_2, ...; Delta_ij = p_i - p_j
    shape: Literal["grid"] | None = None
    spacing: PositiveLength | None = None  # of the shape; 10 m


class GraphSection(Section):
    """Who hears whom: `edges`, or a named `shape`; and who follows the reference itself."""

    shape: Literal["path", "ring"] | None = None
    ahead: PositiveNumber | None = None  # a_(i,i-1) of the shape; 1
    behind: PositiveNumber | None = None  # a_(i,i+1) of the shape; 1
    edges: dict[str, PositiveNumber] | None = None  # "1->2": a_21, vehicle 2 hears vehicle 1
    reference: Literal["all"] | list[int] = "all"  # the vehicles with b_i = 1, the others have 0


class InitialState(Section):
    """One vehicle at t = 0."""

    position: Position
    pitch: Angle = 0.0
    yaw: Angle = 0.0
    surge: Speed = 0.0
    sway: Speed = 0.0
    heave: Speed = 0.0
    pitch_rate: AngularRate = 0.0
    yaw_rate: AngularRate = 0.0


class Scatter(Section):
    """Every vehicle near its offset: x and y uniform within the scatter, z below the offset by at most it."""

    scatter: Length
    surge: Speed = 0.0


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
    angle_noise: AngleNoise = 0.0
    velocity_noise: NoisySpeed = 0.0
    rate_noise: RateNoise = 0.0


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
    slew: Slew | None = None


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
    u_floor: NoisySpeed | None = None
    rho_eps: NoisySpeed | None = None
    cos_eps: PositiveNumber | None = None
    u_eps: Annotated[float, *_scalar(q.SPEED, "positive")] | None = None


class NeighboursSection(Section):
    """How an agent estimates where a neighbour is now from what it heard last."""

    extrapolate: Extrapolation = "hold"


class NetworkSection(Section):
    """The network between the agents; `network: ideal` in the file is `ideal` here."""

    ideal: bool = False
    period: Period = 100_000_000  # one round: every agent sends once per period
    links: dict[Annotated[str, _reader(_selector)], LinkCondition] = {}  # the last that matches a link wins


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
    raise mistake(f'expected a mapping with a period and links, or "ideal", got {q.describe(value)}')


def _show_network(network: NetworkSection) -> Any:
    if network.ideal:
        return "ideal"
    links = {selector: print_condition(condition) for selector, condition in network.links.items()}
    return {"period": q.show_time(network.period)} | ({"links": links} if links else {})


def _initial(value: Any) -> Any:
    if isinstance(value, list):
        return {"vehicles": value}
    if isinstance(value, dict):
        return {"scatter": value}
    raise mistake(f"expected a list with one entry per vehicle, or a scatter, got {q.describe(value)}")


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
    physics: PhysicsSection = Field(default_factory=lambda: PhysicsSection())
    log: LogSection = LogSection()
    checks: ChecksSection = ChecksSection()


class PhysicsSection(Section):
    """How finely the sea is integrated."""

    substeps: Annotated[int, Field(ge=1, le=100)] = 1  # RK4 steps per tick


ScenarioSpec.model_rebuild()
