"""What a fault concerns, as a list that can be made shorter: vehicles, the sides of a partition, or links."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from fleet.quantities import vehicle_numbers
from fleet.scenario.faults.kind import FleetFaultKind, LinkFaultKind
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.faults.of_links import LinkFault, PartitionFault
from fleet.scenario.faults.partitions import partition
from netem.condition import Link
from netem.errors import TextError
from netem.link_selector import parse_selector


class Targets(NamedTuple):
    """What a fault concerns."""

    items: list[Any]
    value: Callable[[list[Any], int], Any]  # the fault with some of the items, in a fleet of a number of vehicles


def targets(kind: str, value: Any, vehicles: int, seed: int, name: str) -> Targets | None:
    """The targets of a fault of a kind.

    Args:
        value: of the key `kind`, as a scenario has it.
        vehicles: their number.
        seed, name: of the scenario and of the fault; both decide which vehicles a partition such as `one` cuts off.

    Returns:
        None: the fault has no list.
    """
    match KINDS[kind]:
        case PartitionFault():
            return _cut_off(value, vehicles, seed, name)
        case LinkFault():
            return Targets([*value], lambda some, _: {key: value[key] for key in some})
        case LinkFaultKind() | FleetFaultKind():
            return None
    try:
        if not isinstance(value, dict):
            return Targets(vehicle_numbers(value), lambda some, _: _text(some))
        named = vehicle_numbers(value["vehicles"]) if "vehicles" in value else [*range(1, vehicles + 1)]
    except TextError:
        return None

    def of(some: list[Any], left: int) -> Any:
        whole = "vehicles" not in value and len(some) == left
        return value if whole else value | {"vehicles": _text(some)}

    return Targets(named, of)


def _cut_off(text: str, vehicles: int, seed: int, name: str) -> Targets | None:
    """The vehicles outside the largest side of a partition. The others join that side when the list gets shorter."""
    everyone = range(1, vehicles + 1)
    try:
        cut = partition(text, vehicles, seed, name)
    except TextError:
        return None
    sides = dict.fromkeys(tuple(j for j in everyone if (i, j) not in cut) for i in everyone)
    if sum(map(len, sides)) != vehicles:  # a ring or a bridge has no sides
        return None
    largest = max(sides, key=len)
    apart = [side for side in sides if side != largest]

    def value(some: list[Any], left: int) -> str:
        if len(some) == 1:
            return f"isolate:{some[0]}"
        rest = [i for i in range(1, left + 1) if i not in some]
        parts = [[i for i in side if i in some] for side in apart]
        return " / ".join(_text(part) for part in (*parts, rest) if part)

    return Targets([i for side in apart for i in side], value)


def _text(numbers: Sequence[int]) -> str:
    return ",".join(map(str, numbers))


def narrower(kind: str, value: Any, links: Sequence[Link]) -> Iterator[Any]:
    """The values of a fault that concern fewer of its links, one step down: from all links to those of one vehicle, and
    from these to a single one."""
    if kind == "link":
        for key, condition in value.items():
            for less in _selectors(key, links):
                yield {less if other == key else other: what for other, what in value.items()} | {less: condition}
    elif isinstance(KINDS[kind], LinkFaultKind) and isinstance(value, dict):
        yield from (value | {"links": less} for less in _selectors(value["links"], links))
    elif isinstance(KINDS[kind], LinkFaultKind):
        yield from _selectors(value, links)


def _selectors(text: str, links: Sequence[Link]) -> list[str]:
    named = parse_selector(text)
    src, dst = ("*" if end is None else str(end) for end in (named.src, named.dst))
    if named.both:
        return [f"{src}->{dst}", f"{dst}->{src}"]
    ends = sorted({i for link in links for i in link})
    if src == dst == "*":
        return [f"{i}->*" for i in ends] + [f"*->{i}" for i in ends]
    return [f"{a}->{b}" for a, b in links if "*" in (src, dst) and named.matches((a, b))]
