"""The faults of a scenario as each core gets them: with links, vehicles and ticks.

| partition | what is cut, both ways |
|---|---|
| `1,2 / 3,4` | the groups from each other; vehicles in none of them from all |
| `halves` | the first half from the second |
| `one` | one vehicle, drawn, from the others |
| `majority` | a drawn minority, as large as it can be, from the majority |
| `ring` | each vehicle sees a majority, no two the same: its neighbours on a drawn ring |
| `bridge` | two halves from each other, but for one vehicle between them, drawn, that both see |
| `isolate:3` | vehicle 3 from all |

The named partitions are Jepsen's. The draws depend on (seed, id of the fault) alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

from msgspec import structs

from fleet.quantities import vehicle_numbers
from fleet.scenario.faults.partitions import partition
from fleet.scenario.schema.faults import ACTIONS, FaultAction, FaultSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.node_names import named
from fleet.scenario.sections.vehicle_events import is_fault
from fleet.scenario.value_types import Section
from netem.condition import Link
from netem.fault_kinds import FaultKind, WorldFaultKind
from netem.faults import NetFault
from netem.grammar import parse_selector, print_condition, select
from netem.lives import Absence
from netem.wire.messages import TimedFault, WorldFault

OF_THE_NETWORK: tuple[str, ...] = get_args(FaultKind)
OF_THE_WORLD: tuple[str, ...] = tuple(kind for kind in WorldFaultKind if kind not in ("pause", "slow"))
MOST_RESTARTS = 3  # of one agent that no fault has killed: its next life would end the same way


@dataclass(frozen=True, slots=True)
class Event:
    """The begin or the end of a fault, for the log and the console."""

    tick: int
    fault: str  # its id
    action: str  # begins | ends
    what: str  # in the words of the scenario

    @property
    def is_fault(self) -> bool:
        """Whether it is a fault; a vehicle that tumbles is the consequence of one."""
        return is_fault(self.what)


class Kill(TimedFault, frozen=True):
    """Agents that end at tick `begin` and, unless `end` is None, are started again at tick `end`."""

    vehicles: tuple[int, ...]
    kind: str = "kill"

    @property
    def absences(self) -> list[Absence]:
        return [Absence(i, self.begin, self.end) for i in self.vehicles]


Part = NetFault | WorldFault | Kill  # of a fault: what one core does


def with_end(part: Part, end: int) -> Part:
    """The same part of a fault, which ends before tick `end`."""
    return structs.replace(part, end=end)


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """Every fault of a scenario, as the cores get it."""

    parts: tuple[Part, ...]  # in order of time
    events: tuple[Event, ...]  # in order of time

    @property
    def network(self) -> tuple[NetFault, ...]:
        return tuple(part for part in self.parts if isinstance(part, NetFault))

    @property
    def world(self) -> tuple[WorldFault, ...]:
        return tuple(part for part in self.parts if isinstance(part, WorldFault))

    @property
    def absences(self) -> tuple[Absence, ...]:
        return tuple(absence for part in self.parts if isinstance(part, Kill) for absence in part.absences)


def plan(spec: ScenarioSpec, links: Sequence[Link]) -> FaultPlan:
    """The faults of a valid scenario. Raises TextError: a partition cannot be made."""
    all_parts: list[Part] = []
    events: list[Event] = []
    last = spec.duration // spec.tick
    for number, section in enumerate(spec.faults, start=1):
        name = section.id or f"f{number}"
        if section.at // spec.tick < last:  # beyond it: a run cut short with --duration; `fleet check` warns
            all_parts += (of_this := parts(section, name, spec, links))
            events += begin_and_end(of_this, section, last, tuple(spec.nodes or ()))
    all_parts.sort(key=lambda part: part.begin)
    events.sort(key=event_order)
    return FaultPlan(tuple(all_parts), tuple(events))


def event_order(event: Event) -> tuple[int, bool, str]:
    """In the log, ends stand before what begins at the same tick; what begins keeps the scenario's order."""
    begins = event.action == "begins"
    return event.tick, begins, "" if begins else event.fault


def begin_and_end(
    of_this: Sequence[Part], section: FaultSection, last: int, names: Sequence[str] = ()
) -> tuple[Event, Event]:
    """The events of a fault in a run of `last` ticks. `names`: of the nodes, if it has some."""
    part, what = of_this[0], words(section, names)
    end = last if part.end is None else min(part.end, last)
    return Event(part.begin, part.id, "begins", what), Event(end, part.id, "ends", what)


def parts(section: FaultSection, name: str, spec: ScenarioSpec, links: Sequence[Link]) -> list[Part]:
    """The parts of one fault, called `name`, one for each core that it concerns.

    Raises TextError: a partition cannot be made.
    """
    begin = section.at // spec.tick
    end = None if section.for_ is None else begin + section.for_ // spec.tick
    kind, who = action(section), vehicles_of(section)
    match kind:
        case "link":
            return [
                NetFault(name, begin, end, "link", select(parse_selector(selector), links), (), condition)
                for selector, condition in (section.link or {}).items()
            ]
        case "down" | "up":
            return [NetFault(name, begin, end, kind, select(parse_selector(getattr(section, kind)), links))]
        case "hold":
            assert section.hold is not None
            held = select(parse_selector(section.hold.links), links)
            back = (1.0,) if section.hold.order == "reversed" else ()
            return [NetFault(name, begin, end, kind, held, values=back)]
        case "duplicate":
            assert section.duplicate is not None
            later, copied = section.duplicate.after // spec.tick, select(parse_selector(section.duplicate.links), links)
            return [NetFault(name, begin, end, kind, copied, ticks=later)]
        case "partition":
            cut = partition(section.partition or "", spec.vehicles, spec.seed, name, links)
            return [NetFault(name, begin, end, "partition", tuple(link for link in links if link in cut))]
        case "mute" | "deaf":
            return [NetFault(name, begin, end, kind, vehicles=who)]
        case "slow":
            assert section.slow is not None
            vehicles = who or tuple(range(1, spec.vehicles + 1))
            late = section.slow.by
            return [
                NetFault(name, begin, end, kind, vehicles=vehicles, ticks=late),
                WorldFault(name, begin, end, WorldFaultKind.SLOW, who, (float(late),)),
            ]
        case "clock":
            values = _numbers_of(section)
            return [
                NetFault(name, begin, end, kind, vehicles=who, values=values),
                WorldFault(name, begin, end, WorldFaultKind.CLOCK, who, values),
            ]
        case "kill":
            if end is not None:
                # An agent begins again with a round: only then do agents send, and the network counts their messages.
                m = 1 if spec.network.ideal else spec.network.period // spec.tick
                end = -(-end // m) * m
                end = end if end < spec.duration // spec.tick else None
            return [Kill(name, begin, end, who)]
        case "gust":
            assert section.gust is not None
            over = begin + -(-section.gust.over // spec.tick)
            end = over if end is None else min(end, over)
    return [WorldFault(name, begin, end, WorldFaultKind(kind), who, _numbers_of(section))]


def acts(found: Sequence[Part]) -> bool:
    """Whether the parts of a fault concern anything: one of links may find none in the graph."""
    return any(not isinstance(part, NetFault) or part.links or part.vehicles for part in found)


def _numbers_of(section: FaultAction) -> tuple[float, ...]:
    """The values of a fault of the world, as `WorldFault` lists them: mostly those of its keys in their order."""
    if (b := section.bias) is not None:
        return *b.position, b.pitch, b.yaw, *b.velocity, b.pitch_rate, b.yaw_rate, b.roll, b.roll_rate
    if (s := section.saturate) is not None:
        return tuple(_ANY if limit is None else limit for limit in (s.surge_force, s.pitch_moment, s.yaw_moment))
    if (c := section.current) is not None:
        return *c.mean, *c.sigma, c.time_constant / 1e9
    if (g := section.gust) is not None:
        return *g.velocity, g.over / 1e9
    if section.clock is not None:
        return section.clock.step / 1e9, section.clock.drift
    values = getattr(section, action(section))
    if not isinstance(values, Section):
        return ()
    each = [value if isinstance(value, tuple) else (value,) for key, value in values if key != "vehicles"]
    return tuple(number for some in each for number in some)


_ANY = 1e300  # N, N m: a limit that nothing reaches


def does_nothing(section: FaultAction) -> bool:
    """Whether the values of a fault are those of none."""
    numbers = _numbers_of(section)
    match action(section):
        case "efficiency":
            return all(number == 1.0 for number in numbers)
        case "saturate":
            return all(number == _ANY for number in numbers)
        case "current":
            return not any(numbers[:6])  # but for the time constant
        case "gust":
            return not any(numbers[:3])
        case "dvl" | "compass" | "fix":
            jumps = numbers[-2] and numbers[-1]
            return not any(numbers[:-2]) and not jumps
        case "noise" | "bias" | "wrench" | "dropout" | "clock":
            return not any(numbers)
    return False


def vehicles_of(section: FaultAction) -> tuple[int, ...]:
    """The vehicles that a fault names; none if it concerns all."""
    value = getattr(section, action(section))
    text = value if isinstance(value, str) else getattr(value, "vehicles", None)
    if text is None or action(section) in ("down", "up", "partition"):
        return ()
    return tuple(vehicle_numbers(text))


def action(section: FaultAction) -> str:
    """The kind of a valid fault."""
    return next(name for name in ACTIONS if getattr(section, name) is not None)


def words(section: FaultAction, names: Sequence[str] = ()) -> str:
    """A fault as a scenario writes it, without its times. `names`: of the nodes, if it has some."""
    name = action(section)
    if name == "link":
        assert section.link is not None
        some = [f"{named(selector, names)}: {print_condition(c)}" for selector, c in section.link.items()]
        return "link " + ", ".join(some)
    value = section.model_dump(exclude_none=True, exclude_defaults=True)[name]
    if isinstance(value, dict):
        return f"{name} {{{', '.join(f'{key}: {inner}' for key, inner in value.items())}}}"
    return f"{name} {named(value, names)}"
