"""The partitions that a fault may name or write, as the links that each cuts."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from itertools import permutations

from fleet.quantities import unknown_vehicle, vehicle_numbers
from netem.condition import Link
from netem.draws import uniform
from netem.errors import SelectorError, TextError

DRAWN_PARTITIONS = ("one", "majority", "ring", "bridge")  # who is cut off depends on the seed and the fault's id
NAMED_PARTITIONS = ("halves", *DRAWN_PARTITIONS, "isolate:N")
_ISOLATE = re.compile(r"isolate:\s*(\d{1,9})", re.ASCII)


def partition(text: str, vehicles: int, seed: int, name: str, among: Iterable[Link] | None = None) -> set[Link]:
    """The directed links that a partition cuts, of all there could be, or of the given ones.

    Raises TextError: the text names no partition of these vehicles.
    """
    cut = _cut(text, vehicles, seed, name)
    return {(a, b) for a, b in (permutations(range(1, vehicles + 1), 2) if among is None else among) if cut(a, b)}


def is_drawn(text: str) -> bool:
    """Whether the seed draws this partition."""
    return text.strip() in DRAWN_PARTITIONS


def _purpose(which: str, name: str) -> str:
    return f"partition {which} {name}"


def _cut(text: str, vehicles: int, seed: int, name: str) -> Callable[[int, int], bool]:
    """A function of two vehicles a and b: whether the partition cuts the link from a to b."""
    everyone = range(1, vehicles + 1)
    if "/" in text:
        groups = _groups(text, vehicles)
        of = {i: number for number, group in enumerate(groups) for i in group}
        return lambda a, b: of.get(a, -a) != of.get(b, -b)  # a vehicle in no group is cut from all
    which = text.strip()
    if is_drawn(which):
        drawn = sorted(everyone, key=lambda i: (uniform(seed, _purpose(which, name), i), i))
    half = (vehicles + 1) // 2
    match which:
        case "halves":
            return lambda a, b: (a <= half) != (b <= half)
        case "one":
            return lambda a, b: (a == drawn[0]) != (b == drawn[0])
        case "majority":
            minority = set(drawn[: (vehicles - 1) // 2])
            return lambda a, b: (a in minority) != (b in minority)
        case "bridge":
            middle, rest = drawn[0], sorted(drawn[1:])
            first = set(rest[: (len(rest) + 1) // 2])
            return lambda a, b: middle not in (a, b) and (a in first) != (b in first)
        case "ring":
            reach = -(-(vehicles // 2) // 2)  # on each side: 2 reach + 1 is the least odd majority
            place = {i: n for n, i in enumerate(drawn)}
            return lambda a, b: min((place[a] - place[b]) % vehicles, (place[b] - place[a]) % vehicles) > reach
        case _ if (isolated := _ISOLATE.fullmatch(which)) and 1 <= int(isolated[1]) <= vehicles:
            alone = int(isolated[1])
            return lambda a, b: (a == alone) != (b == alone)
    raise NoPartition(text, vehicles)


class NoPartition(SelectorError):
    """A text that names no partition."""

    def __init__(self, text: str, vehicles: int) -> None:
        hint = f'write groups such as "1,2 / 3,4", or one of {", ".join(NAMED_PARTITIONS)}'
        super().__init__(f'"{text[:40]}" is no partition of vehicles 1 to {vehicles}', hint=hint)
        self.text = text

    def _in_names(self, names: Sequence[str]) -> str:
        return f'"{self.text[:40]}" is no partition of {", ".join(names)}'


def _groups(text: str, vehicles: int) -> list[list[int]]:
    groups: list[list[int]] = []
    for part in text.split("/"):
        try:
            group = vehicle_numbers(part)
        except TextError as error:
            error.hint = 'write groups such as "1,2 / 3,4"'
            raise
        for i in group:
            if not 1 <= i <= vehicles:
                raise unknown_vehicle(i, vehicles)
            if any(i in other for other in groups):
                raise TextError(f"vehicle {i} is in two groups")
        groups.append(group)
    return groups
