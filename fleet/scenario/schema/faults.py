"""Faults at given times."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field, PlainSerializer

from fleet.quantities import describe_value
from fleet.scenario import value_types as v
from fleet.scenario.schema.checks import OnlyTrue, Quantity
from fleet.scenario.value_types import Section, mistake, word_for
from netem.parsing import nearest

# --- the sea: current and sensor noise


class CurrentSection(Section):
    """An irrotational current, NED: constant, or with a first-order Gauss-Markov part."""

    mean: v.Velocity = (0.0, 0.0, 0.0)
    sigma: v.Speeds = (0.0, 0.0, 0.0)
    time_constant: v.Period = 60_000_000_000


def _show_current(current: CurrentSection | None) -> Any:
    return current and (current.model_dump() if any(current.sigma) else current.model_dump()["mean"])


Current = Annotated[CurrentSection, word_for("mean"), PlainSerializer(_show_current)]


class SeaSection(Section):
    """The forces of the sea on every vehicle."""

    disturbance: Literal["none", "paper"] = "none"
    current: Current = CurrentSection.model_construct()


class SensorsSection(Section):
    """Standard deviations of white noise on the navigation sensor; 0 is off."""

    position_noise: v.Length = 0.0
    angle_noise: v.Angle = 0.0
    velocity_noise: v.Speed = 0.0
    rate_noise: v.AngularRate = 0.0


class SensorNoise(SensorsSection):
    """More noise on some vehicles' navigation."""

    vehicles: v.VehicleNumbers | None = None


class OfVehicles(Section):
    """The values of a fault of some vehicles, or of all."""

    vehicles: v.VehicleNumbers | None = None


class SensorBias(OfVehicles):
    position: v.Position = (0.0, 0.0, 0.0)  # NED
    velocity: v.Velocity = (0.0, 0.0, 0.0)  # body
    pitch: v.SignedAngle = 0.0
    yaw: v.SignedAngle = 0.0
    pitch_rate: v.SignedAngularRate = 0.0
    yaw_rate: v.SignedAngularRate = 0.0
    roll: v.SignedAngle = 0.0  # of vehicles that have it
    roll_rate: v.SignedAngularRate = 0.0


class Efficiency(OfVehicles):
    """The share of each command that the actuators still produce."""

    surge: v.Ratio = 1.0
    pitch: v.Ratio = 1.0
    yaw: v.Ratio = 1.0


class Saturation(OfVehicles):
    """Smaller limits of the actuators."""

    surge_force: v.Force | None = None
    pitch_moment: v.Moment | None = None
    yaw_moment: v.Moment | None = None


class Wrench(OfVehicles):
    """A constant force and moment in body axes."""

    force: v.ForceVector = (0.0, 0.0, 0.0)
    pitch_moment: v.AnyMoment = 0.0
    yaw_moment: v.AnyMoment = 0.0


class Dropout(OfVehicles):
    """The navigation sensor repeats its last measurement, with this probability at each tick."""

    probability: Annotated[v.Probability, v.loss_once("probability")]


class DvlFault(OfVehicles):
    """The DVL of vehicles that navigate: samples that are lost, biased, or jump."""

    lost: Annotated[v.Probability, v.loss_once("lost")] = 0.0  # of each sample
    bias: v.Velocity = (0.0, 0.0, 0.0)  # body
    jump: v.Speed = 0.0  # standard deviation on each axis
    chance: v.Probability = 0.1  # that a sample jumps


class CompassFault(OfVehicles):
    """The same of the heading sensor."""

    lost: Annotated[v.Probability, v.loss_once("lost")] = 0.0
    bias: v.SignedAngle = 0.0
    jump: v.Angle = 0.0
    chance: v.Probability = 0.1


class FixFault(OfVehicles):
    """The same of the fixes of the position."""

    lost: Annotated[v.Probability, v.loss_once("lost")] = 0.0
    bias: v.PlanPosition = (0.0, 0.0)  # north, east
    jump: v.Length = 0.0
    chance: v.Probability = 0.1


class Slow(OfVehicles):
    """The commands and the messages of an agent are late."""

    by: v.Ticks


class ClockFault(OfVehicles):
    """A clock is set to another time, and goes faster or slower. At the end the step is undone."""

    step: v.ClockTime = 0
    drift: v.ClockDrift = 0.0


class Hold(Section):
    """Packets that are sent meanwhile are kept, and come when the fault is over."""

    links: v.LinkSelector
    order: Literal["sent", "reversed"] = "sent"  # reversed: the last one first, at the pace at which they were sent


class Duplicate(Section):
    """Packets that are sent meanwhile come once more, so much later."""

    links: v.LinkSelector
    after: v.Period


class Gust(Section):
    """A current that rises to a velocity and falls again, for all vehicles."""

    velocity: v.Velocity
    over: v.Period


def _show_hold(hold: Hold | None) -> Any:
    return hold and (hold.model_dump() if hold.order == "reversed" else hold.model_dump()["links"])


HoldChoice = Annotated[Hold, word_for("links"), PlainSerializer(_show_hold)]


FaultId = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")]


class FaultTimes(Section):
    """When a fault begins, and for how long it lasts. It always ends, at the latest with the run."""

    id: FaultId | None = None  # f1, f2, ...
    at: v.Time
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # to the end


def _conditions(value: Any) -> Any:
    if isinstance(value, str):
        text = 'expected links with their condition, such as link: {"1->2": loss 30% delay 2s}'
        raise mistake(f"{text}, got {describe_value(value)}")
    return value


class FaultAction(Section):
    """The effect of a fault: the entry gives exactly one of these keys.

    All other lists of kinds follow this one.
    """

    # In place of the links' own conditions.
    link: Annotated[dict[v.LinkSelector, v.LinkCondition] | None, BeforeValidator(_conditions)] = None
    down: v.LinkSelector | None = None
    up: v.LinkSelector | None = None  # the end of every down, and of the links' own
    partition: str | None = None  # "1,2 / 3,4", or halves, one, majority, ring, bridge, isolate:3
    hold: HoldChoice | None = None
    duplicate: Duplicate | None = None
    mute: v.VehicleNumbers | None = None  # sends nothing
    deaf: v.VehicleNumbers | None = None  # receives nothing
    slow: Slow | None = None
    clock: ClockFault | None = None  # of the agent and its modem
    kill: v.VehicleNumbers | None = None  # the agent ends; the vehicle drifts until it is restarted
    pause: v.VehicleNumbers | None = None  # the agent is suspended; the vehicle holds its last command
    noise: SensorNoise | None = None
    bias: SensorBias | None = None
    freeze: v.VehicleNumbers | None = None  # the same measurement again and again
    dropout: Dropout | None = None
    dvl: DvlFault | None = None
    compass: CompassFault | None = None
    fix: FixFault | None = None
    efficiency: Efficiency | None = None
    saturate: Saturation | None = None
    off: v.VehicleNumbers | None = None  # no force, no moments
    stuck: v.VehicleNumbers | None = None  # those of the tick at which it began
    current: Current | None = None  # in addition to the sea's own, for all vehicles
    gust: Gust | None = None
    wrench: Wrench | None = None


ACTIONS = tuple(FaultAction.model_fields)


class FaultSection(FaultAction, FaultTimes):
    """One fault."""


def read_fault(value: Any) -> Any:
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


FaultEntry = Annotated[FaultSection, BeforeValidator(read_fault)]


# --- triggers: faults that begin when an agent reports something


class WhenSection(Section):
    """A moment in what agents report: one condition begins to hold, or a value changes.

    A condition that holds in the first sample begins there.
    """

    topic: str  # topic group, dot, field: control.leads
    vehicles: v.VehicleNumbers | None = None  # whose reports count; all
    above: Quantity | None = None
    below: Quantity | None = None
    equals: Quantity | None = None
    changes: OnlyTrue = None
    after: v.Time = 0  # earlier samples do not count
    before: v.Period | None = None  # nor those from then on; to the end


class TriggerSection(Section):
    """A fault that begins some time after such a moment; at most once in a run."""

    id: FaultId | None = None  # t1, t2, ...
    when: WhenSection
    nth: Annotated[int, Field(ge=1)] = 1  # which of these moments, in the order of time and vehicles
    wait: v.Period | None = None  # from the moment on; a round, which is also the least
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # to the end
    fault: dict[str, Any]  # as in `faults`; itself, others and neighbours stand for numbers


# --- nemesis: faults that the seed draws, on a grid of times or as a swarm


# The kinds that need nothing but a target, which a nemesis draws.
DrawnKind = Literal["partition", "down", "hold", "mute", "deaf", "kill", "pause", "freeze", "off", "stuck"]
# The kinds of a swarm whose strength is drawn as well; loss, delay and rate are those of links.
StrongKind = Literal[
    "loss",
    "delay",
    "rate",
    "duplicate",
    "slow",
    "clock",
    "dvl",
    "compass",
    "fix",
    "bias",
    "noise",
    "dropout",
    "efficiency",
    "gust",
]
WORDS: tuple[str, ...] = (*get_args(DrawnKind), *get_args(StrongKind))
Aim = Literal["any", "leader", "hub", "bridge", "speaker"]


class NemesisPick(FaultAction):
    """A fault as it may come, or the name of one whose target, and perhaps strength, is drawn each time."""

    drawn: DrawnKind | StrongKind | None = None


def _pick(value: Any) -> Any:
    if not isinstance(value, str):
        return read_fault(value)
    if value not in WORDS:
        hint = nearest(value, WORDS) or 'or a fault such as {link "*": loss 40%}'
        raise mistake(f"expected one of {', '.join(WORDS)}, got {value[:40]!r}", hint=hint)
    return {"drawn": value}


Picks = Annotated[list[Annotated[NemesisPick, BeforeValidator(_pick)]], Field(min_length=1)]


class NemesisSection(Section):
    """Random faults from the seed.

    Without `mode` one of `pick` begins in every period `every`, each for the time `for`. A swarm draws which kinds are
    on, and when, for how long and how strongly each fault holds. Episodes are a few faults in a unit of time of the
    protocol, with quiet times between them. Liveness is a swarm up to `heal`; then a core of
    vehicles has no fault any more, and all others stay broken to the end.
    """

    every: v.Period | None = None  # without mode
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # without mode
    pick: Picks | None = None  # with a mode: all kinds that fit the scenario
    start: v.Time | None = None  # of the first; `every`, and 0 s with a mode
    until: v.Period | None = None  # when the last has ended; the end of the run, three quarters of it in a swarm
    mode: Literal["swarm", "episodes", "liveness"] | None = None
    most_silent: Annotated[int, Field(ge=1)] | None = None  # vehicles killed, suspended or mute at once; any number
    mean: v.Period | None = None  # time from one beginning to the next; the seed draws it
    aims: Annotated[list[Aim], Field(min_length=1)] | None = None  # all
    leader: Annotated[int, Field(ge=1)] | None = None  # vehicle that the aim `leader` means
    unit: v.Period | None = None  # episodes: lease_s or forget_after_s of the agent, drop_after, or ten rounds
    watch: Annotated[list[str], Field(min_length=1)] | None = None  # episodes: signals whose reports begin faults
    core: v.VehicleNumbers | None = None  # liveness: a drawn majority that links connect
    heal: v.Time | None = None  # liveness: half of the run
