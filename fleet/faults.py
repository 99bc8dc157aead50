"""From a scenario's `faults:` to what each core is told: explicit links, vehicles and ticks.

| partition | what is cut, both ways |
|---|---|
| `1,2 / 3,4` | the groups from each other; vehicles in none of them from all |
| `halves` | the first half from the second |
| `one` | one vehicle, drawn, from the others |
| `majority` | a drawn minority, as large as it can be, from the majority |
| `ring` | each vehicle sees a majority, no two the same: its neighbours on a drawn ring |
| `bridge` | two halves from each other, but for one vehicle between them, drawn, that both see |
| `isolate:3` | vehicle 3 from all |

The named ones are Jepsen's. What is drawn depends on (seed, number of the fault) alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from fleet.fields import vehicle_numbers
from fleet.schema import FaultSection, ScenarioSpec
from netem.config import Link
from netem.draws import uniform
from netem.faults import NetFault
from netem.grammar import parse_selector, print_condition, select
from world.faults import WorldFault

NAMED_PARTITIONS = ("halves", "one", "majority", "ring", "bridge", "isolate:N")
OF_THE_NETWORK = ("link", "down", "partition", "mute", "deaf")
OF_THE_WORLD = ("noise", "bias", "freeze", "efficiency", "saturate", "off", "stuck", "current", "wrench")
ACTIONS = (*OF_THE_NETWORK, "kill", *OF_THE_WORLD)


class FaultError(ValueError):
    """A partition that cannot be made; `hint` says what to write."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


@dataclass(frozen=True, slots=True)
class Event:
    """A fault begins or ends: what the log and the console are told."""

    tick: int
    fault: str  # its id
    action: str  # begins | ends
    what: str  # in the words of the scenario


@dataclass(frozen=True, slots=True)
class Plan:
    """Every fault of a scenario, for the cores."""

    network: tuple[NetFault, ...]
    world: tuple[WorldFault, ...]
    kills: dict[int, int]  # vehicle -> tick from which it has no agent
    events: tuple[Event, ...]  # in order of time


def plan(spec: ScenarioSpec, links: Sequence[Link]) -> Plan:
    """The faults of a valid scenario.

    Raises:
        FaultError: a partition cannot be made.
    """
    network: list[NetFault] = []
    world: list[WorldFault] = []
    kills: dict[int, int] = {}
    events: list[Event] = []
    last = spec.duration // spec.tick
    for number, section in enumerate(spec.faults, start=1):
        name = section.id or f"f{number}"
        begin = section.at // spec.tick
        end = None if section.for_ is None else begin + section.for_ // spec.tick
        kind = action(section)
        if begin >= last:
            continue  # a run cut short with --duration; `fleet check` warns
        if kind != "kill":  # a death is logged when its tick is seen, whoever caused it
            events.append(Event(begin, name, "begins", words(section)))
            events.append(Event(last if end is None else min(end, last), name, "ends", words(section)))
        if kind == "kill":
            for i in vehicles_of(section):
                kills[i] = min(begin, kills.get(i, begin))
        elif kind in OF_THE_WORLD:
            world.append(world_fault(section, name, spec))
        else:
            network += network_faults(section, name, number, spec, links)
    network.sort(key=lambda fault: fault.begin)
    world.sort(key=lambda fault: fault.begin)
    events.sort(key=lambda event: (event.tick, event.action == "begins"))
    return Plan(tuple(network), tuple(world), kills, tuple(event for event in events if event.tick <= last))


def network_faults(
    section: FaultSection, name: str, number: int, spec: ScenarioSpec, links: Sequence[Link]
) -> list[NetFault]:
    """What netem is told of one fault.

    Args:
        number: of the fault in the scenario, from 1: what a partition draws depends on it.

    Raises:
        FaultError: a partition cannot be made.
    """
    begin = section.at // spec.tick
    end = None if section.for_ is None else begin + section.for_ // spec.tick
    match action(section):
        case "link":
            return [
                NetFault(name, begin, end, "link", select(parse_selector(selector), links), (), condition)
                for selector, condition in (section.link or {}).items()
            ]
        case "down":
            return [NetFault(name, begin, end, "down", select(parse_selector(section.down or ""), links))]
        case "partition":
            cut = partition(section.partition or "", spec.vehicles, spec.seed, number)
            return [NetFault(name, begin, end, "partition", tuple(link for link in links if link in cut))]
        case "mute":
            return [NetFault(name, begin, end, "mute", vehicles=vehicles_of(section))]
        case _:
            return [NetFault(name, begin, end, "deaf", vehicles=vehicles_of(section))]


def world_fault(section: FaultSection, name: str, spec: ScenarioSpec) -> WorldFault:
    """What the world is told of one fault."""
    begin = section.at // spec.tick
    end = None if section.for_ is None else begin + section.for_ // spec.tick
    kind = action(section)
    return WorldFault(name, begin, end, kind, vehicles_of(section), _numbers_of(section))  # type: ignore[arg-type]


def _numbers_of(section: FaultSection) -> tuple[float, ...]:
    """The values of a fault of the world, as `world.faults` lists them."""
    if (n := section.noise) is not None:
        return n.position_noise, n.angle_noise, n.velocity_noise, n.rate_noise
    if (b := section.bias) is not None:
        return *b.position, b.pitch, b.yaw, *b.velocity, b.pitch_rate, b.yaw_rate
    if (e := section.efficiency) is not None:
        return e.surge, e.pitch, e.yaw
    if (s := section.saturate) is not None:
        return tuple(_ANY if limit is None else limit for limit in (s.surge_force, s.pitch_moment, s.yaw_moment))
    if section.current is not None:
        return section.current
    if (w := section.wrench) is not None:
        return *w.force, w.pitch_moment, w.yaw_moment
    return ()


_ANY = 1e300  # N, N m: no limit of a fault's own


def vehicles_of(section: FaultSection) -> tuple[int, ...]:
    """The vehicles that a fault names; none where it concerns all."""
    value = getattr(section, action(section))
    text = value if isinstance(value, str) else getattr(value, "vehicles", None)
    if text is None or action(section) in ("down", "partition"):
        return ()
    return tuple(vehicle_numbers(text))


def action(section: FaultSection) -> str:
    """What a valid fault does."""
    return next(name for name in ACTIONS if getattr(section, name) is not None)


def words(section: FaultSection) -> str:
    """A fault in the words of the scenario."""
    name = action(section)
    if name == "link":
        assert section.link is not None
        return "link " + ", ".join(f"{selector}: {print_condition(c)}" for selector, c in section.link.items())
    value = section.model_dump(exclude_none=True, exclude_defaults=True)[name]
    if isinstance(value, dict):
        return f"{name} {{{', '.join(f'{key}: {inner}' for key, inner in value.items())}}}"
    return f"{name} {value}"


def partition(text: str, vehicles: int, seed: int, number: int) -> set[Link]:
    """The directed links that a partition cuts, of all there could be.

    Raises:
        FaultError: the text names no partition of these vehicles.
    """
    everyone = list(range(1, vehicles + 1))
    if "/" in text:
        groups = _groups(text, vehicles)
        return _between([*groups, *([i] for i in everyone if not any(i in group for group in groups))])
    name, _, who = text.strip().partition(":")
    drawn = sorted(everyone, key=lambda i: (uniform(seed, "partition", number, i), i))
    half = (vehicles + 1) // 2
    match name:
        case "halves":
            return _between([everyone[:half], everyone[half:]])
        case "one":
            return _between([drawn[:1], drawn[1:]])
        case "majority":
            minority = (vehicles - 1) // 2
            return _between([drawn[:minority], drawn[minority:]])
        case "bridge":
            middle, rest = drawn[0], sorted(drawn[1:])
            split = (len(rest) + 1) // 2
            return _between([rest[:split], rest[split:]]) - {link for link in _all(everyone) if middle in link}
        case "ring":
            reach = -(-(vehicles // 2) // 2)  # on each side: 2 reach + 1 is the least odd majority
            place = {i: n for n, i in enumerate(drawn)}
            return {(a, b) for a, b in _all(everyone) if _apart(place[a], place[b], vehicles) > reach}
        case "isolate" if who.strip().isdigit() and 1 <= int(who) <= vehicles:
            return _between([[int(who)], [i for i in everyone if i != int(who)]])
    raise FaultError(
        f'"{text[:40]}" is no partition of vehicles 1 to {vehicles}',
        f'write groups such as "1,2 / 3,4", or one of {", ".join(NAMED_PARTITIONS)}',
    )


def _groups(text: str, vehicles: int) -> list[list[int]]:
    groups: list[list[int]] = []
    for part in text.split("/"):
        try:
            group = vehicle_numbers(part)
        except ValueError as error:
            raise FaultError(str(error), 'write groups such as "1,2 / 3,4"') from None
        for i in group:
            if not 1 <= i <= vehicles:
                raise FaultError(f"there is no vehicle {i}: they are 1 to {vehicles}")
            if any(i in other for other in groups):
                raise FaultError(f"vehicle {i} is in two groups")
        groups.append(group)
    return groups


def _between(groups: Sequence[Iterable[int]]) -> set[Link]:
    sets = [set(group) for group in groups]
    return {(a, b) for x in sets for y in sets if x is not y for a in x for b in y}


def _all(vehicles: list[int]) -> set[Link]:
    return {(a, b) for a in vehicles for b in vehicles if a != b}


def _apart(a: int, b: int, n: int) -> int:
    return min((a - b) % n, (b - a) % n)
