"""What a scenario file may say: every key, its meaning, its unit, its default.

The models hold validated values in SI units (times: integer ns) and print themselves with units. What needs
two keys at once is checked in `fleet.scenario.rules.apply`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, get_args

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

from agents.config import Angles, Codec, Cost, Extrapolation, OnError
from fleet.quantities import QuantityError, describe, show_time, vehicle_numbers
from fleet.scenario.schema.value_types import (
    Acceleration,
    Angle,
    AngularRate,
    AnyMoment,
    BitRate,
    Bytes,
    Count,
    Damping,
    Force,
    ForceVector,
    Fraction,
    Frequency,
    Gain,
    Gains,
    Inertia,
    Layers,
    Length,
    Level,
    LinkCondition,
    LinkSelector,
    Mass,
    Moment,
    Period,
    PitchLimit,
    Position,
    PositiveAcceleration,
    PositiveLength,
    PositiveNumber,
    PositiveSpeed,
    Probability,
    Ratio,
    RotationDamping,
    Salinity,
    SignedAngle,
    SignedAngularRate,
    SignedSpeed,
    Speed,
    Speeds,
    Spreading,
    Temperature,
    Ticks,
    TicksOrNever,
    Time,
    VehicleNumbers,
    Velocity,
    Weights,
    mistake,
)
from netem.grammar import print_condition
from netem.parsing import nearest
from world.config import DEFAULT_SUBSTEPS


class Section(BaseModel):
    """A mapping with known keys; with nothing in it, it may also be left empty."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _empty(cls, value: Any) -> Any:
        return {} if value is None else value


class ReferenceSection(Section):
    """The trajectory that the fleet follows, the paper's eta_1^d(t); which keys a shape takes is in `fleet.scenario.schema.shapes`."""

    shape: Literal["line", "circle", "helix", "lawn-mower", "waypoints"] | None = None  # line
    start: Position | None = None  # NED: north, east, down
    velocity: Velocity | None = None
    speed: PositiveSpeed | None = None
    center: Position | None = None
    radius: PositiveLength | None = None
    bearing: SignedAngle | None = None  # of the start as seen from the centre, clockwise from north
    turn: Literal["starboard", "port"] | None = None  # starboard
    sink: SignedSpeed | None = None  # of a helix: downwards
    heading: SignedAngle | None = None  # of a lawn-mower's first leg, clockwise from north
    leg: PositiveLength | None = None
    legs: Annotated[int, Field(ge=1, le=1000)] | None = None
    spacing: PositiveLength | None = None
    points: list[Position] | None = None
    acceleration: PositiveAcceleration | None = None  # in the turns at waypoints
    closed: bool | None = None  # waypoints: from the last one back to the first, again and again


class FormationShape(Section):
    """Where each vehicle belongs: explicit `offsets`, or a named `shape`."""

    offsets: list[Position] | None = None  # p_1, p_2, ...; Delta_ij = p_i - p_j
    shape: Literal["line", "column", "wedge", "circle", "grid"] | None = None
    spacing: PositiveLength | None = None  # of the shape, between neighbours; 10 m
    heading: SignedAngle | None = None  # what is ahead in the shape, clockwise from north; 0


class FormationChange(FormationShape):
    """A new formation, taken up smoothly."""

    at: Time
    over: Period


class FormationSection(FormationShape):
    """Where each vehicle belongs, relative to the reference, and how that changes."""

    changes: list[FormationChange] | None = None


class _Followers:
    """`all`, or a list of numbers, or `1` or `2-4, 7` as everywhere else where vehicles are named.

    A plain union would report a mistake in the list once per alternative.
    """

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
        if isinstance(value, int) and not isinstance(value, bool):
            return [value]
        if isinstance(value, str) and value[:1].isdigit():
            try:
                return vehicle_numbers(value)
            except QuantityError as error:
                raise mistake(error.message) from None
        raise mistake(f'expected "all" or a list of vehicle numbers such as [1, 3], got {describe(value)}')


class StandbySection(Section):
    """Vehicles that follow the reference themselves while none of those they hear that follow it has been heard."""

    vehicles: VehicleNumbers
    after: Period  # for so long


class GraphSection(Section):
    """Who hears whom: `edges`, or a named `shape`; and who follows the reference itself."""

    shape: Literal["path", "ring", "star", "complete", "nearest", "random"] | None = None
    ahead: PositiveNumber | None = None  # path, ring: a_(i,i-1); 1
    behind: PositiveNumber | None = None  # path, ring: a_(i,i+1); 1
    weight: PositiveNumber | None = None  # the other shapes: every a_ij; 1
    hub: Annotated[int, Field(ge=1)] | None = None  # star: who hears all and is heard by all; 1
    count: Annotated[int, Field(ge=1)] | None = None  # nearest: how many each vehicle hears; 2
    probability: Probability | None = None  # random: of each pair beyond the tree that connects all; 20 %
    edges: dict[str, PositiveNumber] | None = None  # "1->2": a_21, vehicle 2 hears vehicle 1
    reference: Annotated[list[int] | Literal["all"], _Followers()] = "all"  # who has b_i = 1; the others have 0
    standby: StandbySection | None = None  # who gets b_i = 1 when those are silent


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
    """Every vehicle near its place: x and y uniform within the scatter, z below the place by at most it.

    `around` the origin the place is the vehicle's offset p_i; around the reference it is where the vehicle should be
    at t = 0, with the reference's course.
    """

    scatter: Length
    surge: SignedSpeed = 0.0
    around: Literal["origin", "reference"] = "origin"


class VehicleSection(Section):
    """The vehicle: a model, shipped or a TOML file, and what differs from it. Commands are clipped to the limits."""

    model: str | None = None  # paper
    m: Mass | None = None
    Iy: Inertia | None = None
    Iz: Inertia | None = None
    beta_udot: Mass | None = None
    beta_vdot: Mass | None = None
    beta_wdot: Mass | None = None
    beta_qdot: Inertia | None = None
    beta_rdot: Inertia | None = None
    beta_u: Damping | None = None
    beta_v: Damping | None = None
    beta_w: Damping | None = None
    beta_q: RotationDamping | None = None
    beta_r: RotationDamping | None = None
    beta_b: AnyMoment | None = None
    surge_force: Force | None = None
    pitch_moment: Moment | None = None
    yaw_moment: Moment | None = None
    tumble_pitch: PitchLimit | None = None  # |pitch| beyond which it tumbles; 80 deg


class ModelErrorSection(Section):
    """By how much the controller's model of the vehicle is wrong, per parameter: 10 % is 1.1 times the truth."""

    m: Ratio | None = None
    Iy: Ratio | None = None
    Iz: Ratio | None = None
    beta_udot: Ratio | None = None
    beta_vdot: Ratio | None = None
    beta_wdot: Ratio | None = None
    beta_qdot: Ratio | None = None
    beta_rdot: Ratio | None = None
    beta_u: Ratio | None = None
    beta_v: Ratio | None = None
    beta_w: Ratio | None = None
    beta_q: Ratio | None = None
    beta_r: Ratio | None = None
    beta_b: Ratio | None = None


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
    disturbance: Literal["none", "paper"] = "none"
    current: Current = CurrentSection()


class SensorsSection(Section):
    """Standard deviations of white noise on the navigation sensor; 0 is off."""

    position_noise: Length = 0.0
    angle_noise: Angle = 0.0
    velocity_noise: Speed = 0.0
    rate_noise: AngularRate = 0.0


def _named(value: Any) -> Any:
    """A law may be given by its name alone."""
    return {"law": value} if isinstance(value, str) else value


class LawSection(Section):
    """A law by name, `package.module:Class`, or entry point; and what a law of yours is made with."""

    law: str
    parameters: dict[str, Any] | None = None


def _show_law(section: LawSection | None) -> Any:
    if section is None or section.parameters:
        return None if section is None else {"law": section.law, "parameters": section.parameters}
    return section.law


LawChoice = Annotated[LawSection, BeforeValidator(_named), PlainSerializer(_show_law)]


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


Profile = Literal["paper", "consistent", "hardened"]
GuidanceChoice = Annotated[GuidanceSection, BeforeValidator(_named)]
TrackingChoice = Annotated[TrackingSection, BeforeValidator(_named)]


class NeighboursSection(Section):
    """How an agent estimates where a neighbour is now from what it heard last."""

    extrapolate: Extrapolation = "hold"
    age_cap: Time = 0  # of the extrapolation; 0: none
    drop_after: Time = 0  # without news for so long, a neighbour's weight is 0 until the next; 0: never


class VehicleOverrides(Section):
    """What is different about some vehicles."""

    agent: LawChoice | None = None
    controller: LawChoice | None = None
    profile: Profile | None = None
    guidance: GuidanceChoice | None = None
    tracking: TrackingChoice | None = None
    neighbours: NeighboursSection | None = None
    vehicle: VehicleSection | None = None
    model_error: ModelErrorSection | None = None
    external: bool | None = None  # somebody else starts its agent, `fleet agent --join` or one of another make
    knows_reference: bool | None = None


class WaterSection(Section):
    """What the speed of sound follows from."""

    temperature: Temperature
    salinity: Salinity = 35.0  # ppt
    depth: Length


class AcousticSection(Section):
    """The acoustic channel: a modem, shipped or a TOML file, and what differs from it; when each talks; the water."""

    modem: str = "s2c"
    bit_rate: BitRate | None = None
    preamble: Time | None = None
    carrier: Frequency | None = None
    bandwidth: Frequency | None = None
    source_level: Level | None = None  # re 1 uPa at 1 m
    directivity: Level | None = None
    max_range: PositiveLength | None = None
    interference_range: Length | None = None
    mtu: Bytes | None = None
    lost_below: Level | None = None
    clear_above: Level | None = None
    capture: Level | None = None
    mac: Literal["aloha", "tdma"] = "aloha"
    backoff: Time | None = None  # aloha: the largest; what makes pure ALOHA carry most
    slot: Period | None = None  # tdma
    guard: Time | None = None  # tdma; 100 ms
    buffer: Annotated[int, Field(ge=1, le=1000)] = 1  # payloads that wait
    sound_speed: PositiveSpeed | None = None  # 1500 m/s
    water: WaterSection | None = None  # in place of a speed
    spreading: Spreading = 1.5
    shipping: Fraction = 0.5
    wind: Speed = 5.0


def _acoustic(value: Any) -> Any:
    """A modem may be given by its name alone; with nothing at all everything is as it comes."""
    return {"modem": value} if isinstance(value, str) else {} if value is None else value


class NetworkSection(Section):
    """The network between the agents; `network: ideal` in the file is `ideal` here."""

    ideal: bool = False
    period: Period = 100_000_000  # one round: every agent sends once per period
    links: dict[LinkSelector, LinkCondition] = {}  # the last that matches a link wins
    acoustic: Annotated[AcousticSection | None, BeforeValidator(_acoustic)] = None  # in the water
    payload: Codec = "full"  # how our own agents write what they tell each other


class SensorNoise(SensorsSection):
    """More noise on some vehicles' navigation."""

    vehicles: VehicleNumbers | None = None


class SensorBias(Section):
    vehicles: VehicleNumbers | None = None
    position: Position = (0.0, 0.0, 0.0)  # NED
    velocity: Velocity = (0.0, 0.0, 0.0)  # body
    pitch: SignedAngle = 0.0
    yaw: SignedAngle = 0.0
    pitch_rate: SignedAngularRate = 0.0
    yaw_rate: SignedAngularRate = 0.0


class Efficiency(Section):
    """What is left of what the actuators should do."""

    vehicles: VehicleNumbers | None = None
    surge: Ratio = 1.0
    pitch: Ratio = 1.0
    yaw: Ratio = 1.0


class Saturation(Section):
    """Smaller limits."""

    vehicles: VehicleNumbers | None = None
    surge_force: Force | None = None
    pitch_moment: Moment | None = None
    yaw_moment: Moment | None = None


class Wrench(Section):
    """A constant force and moment in body axes."""

    vehicles: VehicleNumbers | None = None
    force: ForceVector = (0.0, 0.0, 0.0)
    pitch_moment: AnyMoment = 0.0
    yaw_moment: AnyMoment = 0.0


class Dropout(Section):
    """Every so often the navigation sensor has nothing new, and reports what it did before."""

    vehicles: VehicleNumbers | None = None
    probability: Probability


class Slow(Section):
    """What an agent decides and sends is late."""

    vehicles: VehicleNumbers | None = None
    by: Ticks


class Gust(Section):
    """A current that rises to a velocity and falls again, for everybody."""

    velocity: Velocity
    over: Period


class FaultTimes(Section):
    """When a fault begins, and for how long it lasts. It always ends, at the latest with the run."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")] | None = None  # f1, f2, ...
    at: Time
    for_: Annotated[Period | None, Field(alias="for")] = None  # to the end


class FaultAction(Section):
    """Exactly one thing that a fault does."""

    link: dict[LinkSelector, LinkCondition] | None = None  # in place of the links' own conditions
    down: LinkSelector | None = None
    up: LinkSelector | None = None  # the end of every down, and of the links' own
    partition: str | None = None  # "1,2 / 3,4", or halves, one, majority, ring, bridge, isolate:3
    mute: VehicleNumbers | None = None  # sends nothing
    deaf: VehicleNumbers | None = None  # hears nothing
    kill: VehicleNumbers | None = None  # the agent ends; the vehicle drifts until it is restarted
    pause: VehicleNumbers | None = None  # the agent is suspended; the vehicle holds its last command
    slow: Slow | None = None
    noise: SensorNoise | None = None
    bias: SensorBias | None = None
    freeze: VehicleNumbers | None = None  # the same measurement again and again
    dropout: Dropout | None = None
    efficiency: Efficiency | None = None
    saturate: Saturation | None = None
    off: VehicleNumbers | None = None  # no force, no moments
    stuck: VehicleNumbers | None = None  # those of the tick at which it began
    current: Current | None = None  # on top of the sea's own, for everybody
    gust: Gust | None = None
    wrench: Wrench | None = None


class FaultSection(FaultAction, FaultTimes):
    """One fault."""


def _fault(value: Any) -> Any:
    """`link 1->2: loss 30%` is short for `link: {1->2: loss 30%}`."""
    if not isinstance(value, dict):
        return value
    long: dict[str, Any] = {}
    for key, inner in value.items():
        if isinstance(key, str) and key.startswith("link ") and "link" not in value:
            long.setdefault("link", {})[key.removeprefix("link ").strip(" \"'")] = inner
        else:
            long[key] = inner
    return long


FaultEntry = Annotated[FaultSection, BeforeValidator(_fault)]


DrawnKind = Literal["partition", "down", "mute", "deaf", "kill", "pause", "freeze", "off", "stuck"]


class NemesisPick(FaultAction):
    """A fault as it may come, or the name of one whose target is drawn each time."""

    drawn: DrawnKind | None = None


def _pick(value: Any) -> Any:
    if not isinstance(value, str):
        return _fault(value)
    if value not in get_args(DrawnKind):
        hint = nearest(value, get_args(DrawnKind)) or 'or a fault such as {link "*": loss 40%}'
        raise mistake(f"expected one of {', '.join(get_args(DrawnKind))}, got {value[:40]!r}", hint=hint)
    return {"drawn": value}


class NemesisSection(Section):
    """Faults at random, from the seed: every so often one of those to pick from, each for a while."""

    every: Period
    for_: Annotated[Period, Field(alias="for")]
    pick: Annotated[list[Annotated[NemesisPick, BeforeValidator(_pick)]], Field(min_length=1)]
    start: Time | None = None  # of the first; `every`
    until: Period | None = None  # when the last has ended; the end of the run


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
    transforms: TicksOrNever | None = None  # of all vehicles, about 10 Hz; 0 ticks: never
    scene: TicksOrNever | None = None  # hulls, links, places for 3D viewers, about 2 Hz; 0 ticks: never
    snapshot: Time | None = None  # of all that determines the rest of the run; about 10 s; 0 s: none


class Below(Section):
    """The largest value over all vehicles, or those named, stays below a limit from a time to the end."""

    below: PositiveLength
    after: Time = 0
    vehicles: VehicleNumbers | None = None


class AtMost(Section):
    at_most: Count


WAIVED = "waived"


class Standing(AtMost):
    """A check that stands in every scenario, with at most 0, unless it says more here or `waived`."""

    at_most: Count = 0
    waived: bool = False  # `tumbled: waived` in the file


class Tumbled(Standing):
    """How often vehicles, all or those named, may tumble: pitch beyond `vehicle.tumble_pitch`."""

    vehicles: VehicleNumbers | None = None


def _standing(value: Any) -> Any:
    return {"waived": True} if value == WAIVED else value


def _show_standing(check: Standing | None) -> Any:
    if check is None or check.waived:
        return None if check is None else WAIVED
    return check.model_dump(exclude={"waived"}, exclude_none=True)


class MaxAge(Section):
    """The age of what was heard last stays below a limit on some links, from a time to the end."""

    below: Period
    after: Time = 0
    links: LinkSelector = "*"


EVERY = "every"  # in place of a fault's id: each that ends before the run does


class Recovery(Section):
    """After a fault has ended, an error comes below `within` in less than `below`, and stays there.

    It stays until the next fault begins, or to the end.
    """

    fault: str  # its id: as given, or f1, f2, ...; or EVERY
    below: Period
    within: PositiveLength
    error: Literal["formation", "consensus"] = "formation"
    vehicles: VehicleNumbers | None = None


class MinSeparation(Section):
    """No two vehicles, of all or of those named, come nearer to each other, from a time to the end."""

    above: PositiveLength
    after: Time = 0
    vehicles: VehicleNumbers | None = None


class Connected(Section):
    """What is delivered within every window of some length connects each vehicle with the reference."""

    window: Period
    after: Time = 0  # when the first window begins
    vehicles: VehicleNumbers | None = None  # who must be reached


def _recoveries(value: Any) -> Any:
    """One may be given without the list."""
    if isinstance(value, dict):
        return [value]
    return None if value == [] else value


def _show_recoveries(recoveries: list[Recovery] | None) -> Any:
    shown = [entry.model_dump(exclude_none=True) for entry in recoveries or ()]
    return shown[0] if len(shown) == 1 else shown or None


class ChecksSection(Section):
    """What decides whether a run passes; `tumbled` and `deaths` also where nothing is said of them."""

    formation_error: Below | None = None  # |eta_i - eta_i^d|
    consensus_error: Below | None = None  # |e_i| from true positions
    recovery_time: Annotated[list[Recovery] | None, BeforeValidator(_recoveries), PlainSerializer(_show_recoveries)] = (
        None
    )
    min_separation: MinSeparation | None = None
    max_age: MaxAge | None = None
    connected: Connected | None = None
    tumbled: Annotated[Tumbled | None, BeforeValidator(_standing), PlainSerializer(_show_standing)] = None
    deaths: Annotated[Standing | None, BeforeValidator(_standing), PlainSerializer(_show_standing)] = None
    qp_infeasible: AtMost | None = None
    ledger: Literal["balanced"] | None = None
    middleware_loss: AtMost | None = None


def _network(value: Any) -> Any:
    if value == "ideal":
        return {"ideal": True}
    if value == "acoustic":
        return {"acoustic": {}}
    if isinstance(value, dict):
        if "ideal" in value:
            raise mistake('write "network: ideal" for the network without latency, which then is nothing else')
        return value
    raise mistake(f'expected a mapping with a period and links, or "ideal", or "acoustic", got {describe(value)}')


def _show_network(network: NetworkSection) -> Any:
    if network.ideal:
        return "ideal"
    links = {selector: print_condition(condition) for selector, condition in network.links.items()}
    shown: dict[str, Any] = {"period": show_time(network.period)}
    if network.acoustic is not None:
        modem = {"modem": network.acoustic.modem}
        shown["acoustic"] = modem | network.acoustic.model_dump(exclude_none=True, exclude_defaults=True)
    return (
        shown | ({"links": links} if links else {}) | ({"payload": "compact"} if network.payload == "compact" else {})
    )


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
    on_death: Literal["continue", "restart", "abort"] = "continue"  # when an agent ends that nobody was to kill
    stall_timeout: Period = 30_000_000_000  # wall time without progress that ends the run
    reference: ReferenceSection
    formation: FormationSection
    graph: GraphSection
    initial: Annotated[InitialSection, BeforeValidator(_initial), PlainSerializer(_show_initial)]
    vehicle: VehicleSection = VehicleSection()
    sea: SeaSection = SeaSection()
    sensors: SensorsSection = SensorsSection()
    model_error: ModelErrorSection = ModelErrorSection()
    external: bool | None = None  # true: every agent is started by somebody else
    knows_reference: bool | None = None  # false: only those in graph.reference and graph.standby know it
    agent: LawChoice | None = None  # in place of controller, guidance and tracking
    controller: LawChoice = LawSection(law="nboc")
    profile: Profile = "paper"
    guidance: GuidanceChoice = GuidanceSection()
    tracking: TrackingChoice = TrackingSection()
    on_controller_error: OnError = "abort"
    controller_budget: Time = 0  # wall time that a law of yours may take for a sample; 0: any
    neighbours: NeighboursSection = NeighboursSection()
    per_vehicle: dict[VehicleNumbers, VehicleOverrides] = {}  # "3" or "2-4, 7"; later ones over earlier ones
    network: Annotated[NetworkSection, BeforeValidator(_network), PlainSerializer(_show_network)]
    physics: PhysicsSection = PhysicsSection()
    log: LogSection = LogSection()
    faults: list[FaultEntry] = []
    nemesis: NemesisSection | None = None  # becomes explicit faults when the scenario is read
    checks: ChecksSection = ChecksSection()
    expect: Literal["pass", "fail"] = "pass"  # fail: the run is meant to fail a check, and exits with 0 when it does
