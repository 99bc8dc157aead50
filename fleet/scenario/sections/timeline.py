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
from typing import NamedTuple

from msgspec import structs

from fleet.scenario.faults.kind import Kill, Part, Surroundings
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.fault_entry import entry_of, is_fault, words_of
from netem.condition import Link
from netem.faults import NetFault
from netem.lives import Absence
from netem.wire.messages import TimedFault, WorldFault

MOST_RESTARTS = 3  # an agent that ends by itself more often would end the same way again


@dataclass(frozen=True, slots=True)
class Event:
    """The begin or the end of a fault, for the log and the console."""

    tick: int
    fault: str  # id of the fault
    action: str  # begins | ends
    what: str  # in words, with the names of nodes
    entry: str  # as data: `fleet.scenario.sections.fault_entry`

    @property
    def is_fault(self) -> bool:
        """Whether it is a fault; a vehicle that tumbles is the consequence of one."""
        return is_fault(self.entry)


class FaultInterval(NamedTuple):
    """When a fault was active, or is planned to be, in s of simulated time."""

    id: str  # as in the scenario, or f1, f2, ...
    begin: float  # [s]
    end: float  # [s], at the latest with the run or its log
    what: str  # in words, such as `kill 3`
    entry: str  # the same as data

    @property
    def is_fault(self) -> bool:
        """Whether it is a fault; a vehicle that tumbles is the consequence of one."""
        return is_fault(self.entry)


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
    part, entry = of_this[0], entry_of(section)
    end, what = last if part.end is None else min(part.end, last), words_of(entry, names)
    return Event(part.begin, part.id, "begins", what, entry), Event(end, part.id, "ends", what, entry)


def parts(section: FaultSection, name: str, spec: ScenarioSpec, links: Sequence[Link]) -> list[Part]:
    """The parts of one fault, called `name`, one for each core that it concerns.

    Raises TextError: a partition cannot be made.
    """
    begin = section.at // spec.tick
    end = None if section.for_ is None else begin + section.for_ // spec.tick
    return section.kind.parts(section.values, TimedFault(name, begin, end), surroundings(spec, links))


def surroundings(spec: ScenarioSpec, links: Sequence[Link]) -> Surroundings:
    """What a fault has to know of a run of this scenario."""
    a_round = 1 if spec.network.ideal else spec.network.period // spec.tick
    return Surroundings(spec.vehicles, spec.seed, tuple(links), spec.tick, a_round, spec.duration // spec.tick)


def acts(found: Sequence[Part]) -> bool:
    """Whether the parts of a fault concern anything: one of links may find none in the graph."""
    return any(not isinstance(part, NetFault) or part.links or part.vehicles for part in found)
