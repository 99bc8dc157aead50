"""The moves of a guided search: they make new fault lists from tried ones.

| move | what it changes |
|---|---|
| shift | when a fault begins |
| stretch | how long it lasts |
| aim | its vehicle, link or partition |
| strength | its numbers become those of another fault of its kind |
| add | another fault, of a list that was tried |
| drop | leaves one out |
| combine | the faults of two lists |
| reseed | nothing of the faults: other packets are lost |

Moves go near a time, where the margin of a check was smallest. All draws are keyed, so a move is a function of its key.
A list that was moved keeps to the limits of the nemesis (`fault_limits`): a guide finds out what breaks within them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import compress, count
from math import log2
from typing import Any

from fleet.quantities import QuantityError, show_time, time_ns
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.faults import FaultSection, read_fault
from fleet.scenario.sections.ground import FaultLimits
from fleet.scenario.sections.partitions import DRAWN_PARTITIONS
from fleet.study.shrink import TIMES
from netem.draws import uniform
from netem.grammar import Selector

PURPOSE = "guide"  # of the draws
MOST_FAULTS = 12  # that moves make
_OF_VEHICLES = frozenset({"kill", "pause", "mute", "deaf", "freeze", "off", "stuck"})

Fault = dict[str, Any]  # as plain values


class Draws:
    """Draws of one slot of one generation, one after the other."""

    def __init__(self, seed: int, *key: int) -> None:
        self._seed, self._key, self._count = seed, key, count()

    def share(self) -> float:
        """From 0 to below 1."""
        return uniform(self._seed, PURPOSE, *self._key, next(self._count))

    def below(self, limit: int) -> int:
        """A whole number."""
        return int(self.share() * limit)

    def one(self, choices: Sequence[Any]) -> Any:
        """One of some."""
        return choices[self.below(len(choices))]


class Mutator:
    """Makes fault lists of a scenario."""

    def __init__(self, scenario: Scenario, latest_ns: int) -> None:
        """Prepare it. Every fault ends by `latest_ns`, so that the run has time to recover."""
        self._vehicles, links = scenario.vehicles, scenario.graph.links
        self._duration, self._tick = scenario.duration_ns, scenario.tick_ns
        self._latest = max(latest_ns, self._tick)
        self._pairs = sorted({(min(link), max(link)) for link in links})
        self._links = sorted(links)
        spec = scenario.undrawn
        self._own = spec.faults
        self._limits = FaultLimits() if spec.nemesis is None else FaultLimits.of(spec.nemesis, spec)

    def mutated(
        self, faults: Sequence[Fault], others: Sequence[Sequence[Fault]], near_ns: int | None, draws: Draws
    ) -> list[Fault]:
        """Change a fault list by one to four random moves.

        Args:
            faults: the list; it stays as it is.
            others: further lists. A move may take faults from them.
            near_ns: time of the smallest margin [ns]. None: not known.
            draws: the random draws.

        Returns:
            The new list, within the limits of the scenario's nemesis.
        """
        made = [dict(fault) for fault in faults]
        for _ in range(1 + min(3, int(-log2(1.0 - draws.share())))):
            made = self._move(made, others, near_ns, draws)
        named = _named(made[:MOST_FAULTS])
        kept = self._limits.kept([FaultSection.model_validate(read_fault(fault)) for fault in named], self._own)
        return list(compress(named, kept))

    def _move(
        self, faults: list[Fault], others: Sequence[Sequence[Fault]], near_ns: int | None, draws: Draws
    ) -> list[Fault]:
        donors = [fault for other in others for fault in other]
        changes: tuple[Callable[[Fault, Draws], Fault], ...]
        changes = self._shift, self._stretch, self._aim, partial(self._strength, donors)
        kind = draws.below(len(changes) + 4)
        if kind < len(changes) and faults:
            place = self._place(faults, near_ns, draws)
            return [*faults[:place], self._fitting(changes[kind](faults[place], draws)), *faults[place + 1 :]]
        match kind:
            case 4 if faults:
                place = draws.below(len(faults))
                return [*faults[:place], *faults[place + 1 :]]
            case 5 if others:
                return [fault for fault in [*faults, *draws.one(others)] if draws.share() < 0.6]
            case 6:
                return faults  # other draws of the network alone: the seed changes
        if not donors:
            return faults
        new = dict(draws.one(donors))
        if near_ns is not None:  # it begins up to a fifth of the run before
            back = draws.share() ** 2 * self._duration / 5
            new["at"] = self._shown(near_ns - back)
        return [*faults, self._fitting(new)]

    def _place(self, faults: list[Fault], near_ns: int | None, draws: Draws) -> int:
        """A fault; in half of all cases the last one to begin before the margin was smallest."""
        before = [n for n, fault in enumerate(faults) if near_ns is not None and _ns(fault, "at") <= near_ns]
        if before and draws.share() < 0.5:
            return max(before, key=lambda n: _ns(faults[n], "at"))
        return draws.below(len(faults))

    def _shift(self, fault: Fault, draws: Draws) -> Fault:
        far = self._duration / 4 * 10 ** (-2 * draws.share())  # log-uniform
        return {**fault, "at": self._shown(_ns(fault, "at") + (far if draws.share() < 0.5 else -far))}

    def _stretch(self, fault: Fault, draws: Draws) -> Fault:
        if "for" not in fault:
            return fault
        return {**fault, "for": self._shown(_ns(fault, "for") * 2 ** (4 * draws.share() - 2))}

    def _aim(self, fault: Fault, draws: Draws) -> Fault:
        kind = kind_of(fault)
        one = 1 + draws.below(self._vehicles)
        if kind in _OF_VEHICLES:
            return {**fault, kind: str(one)}
        if kind == "down" and self._pairs:
            both = draws.share() < 0.7
            src, dst = draws.one(self._pairs if both else self._links)
            return {**fault, kind: str(Selector(src, dst, both=both))}
        if kind == "partition" and self._vehicles > 1:
            names = ("halves", "one", f"isolate:{one}", *DRAWN_PARTITIONS)
            return {**fault, kind: draws.one(names)}
        if kind == "link" and isinstance(fault[kind], dict) and self._pairs:
            (condition, *_) = fault[kind].values()
            src, dst = draws.one(self._pairs)
            where = "*" if draws.share() < 0.3 else str(Selector(src, dst, both=True))
            return {**fault, kind: {where: condition}}
        if isinstance(fault[kind], dict) and "vehicles" in fault[kind]:
            return {**fault, kind: {**fault[kind], "vehicles": str(one)}}
        return fault

    def _strength(self, donors: Sequence[Fault], fault: Fault, draws: Draws) -> Fault:
        """The fault with the numbers of another one, so that it is never stronger than what a seed draws."""
        kind = kind_of(fault)
        alike = [other[kind] for other in donors if kind in other and _forms(other[kind]) == _forms(fault[kind])]
        if isinstance(fault[kind], str) or not alike:
            return self._stretch(fault, draws)
        other = draws.one(alike)
        if kind == "link":
            return {**fault, kind: dict(zip(fault[kind], other.values(), strict=True))}
        return {**fault, kind: {**other, **{key: fault[kind][key] for key in ("vehicles",) if key in fault[kind]}}}

    def _fitting(self, fault: Fault) -> Fault:
        """The fault with times that fit into the run."""
        at = min(max(0, _ns(fault, "at")), self._latest - self._tick) // self._tick * self._tick
        fits = {**fault, "at": show_time(at)}
        if "for" in fits or at + self._duration > self._latest:
            lasts = min(_ns(fits, "for") if "for" in fits else self._duration, self._latest - at)
            if (longest := self._limits.longest(kind_of(fits))) is not None:
                lasts = min(lasts, longest)
            fits["for"] = self._shown(max(lasts, self._tick))
        return fits

    def _shown(self, ns: float) -> str:
        """A time in whole ticks."""
        return show_time(max(0, int(ns)) // self._tick * self._tick)


def kind_of(fault: Fault) -> str:
    """The kind of a fault."""
    return next(key for key in fault if key not in TIMES)


def _forms(value: Any) -> tuple[int, bool]:
    """The form of a fault's values. The numbers of a fault fit another fault only if both forms are equal."""
    return (len(value), "vehicles" in value) if isinstance(value, dict) else (0, False)


def end_of(fault: Fault, duration_ns: int) -> int:
    """When it ends [ns]."""
    return min(duration_ns, _ns(fault, "at") + _ns(fault, "for")) if "for" in fault else duration_ns


def _named(faults: list[Fault]) -> list[Fault]:
    """The faults in order of time, each with an id of its own."""
    taken: set[str] = set()
    named = []
    for fault in sorted(faults, key=lambda fault: _ns(fault, "at")):
        name = wanted = str(fault.get("id", "guided"))
        for number in count(2):
            if name not in taken:
                break
            name = f"{wanted[:26]}-{number}"
        taken.add(name)
        named.append({**fault, "id": name})
    return named


def _ns(fault: Fault, key: str) -> int:
    try:
        return time_ns(fault[key])
    except QuantityError:  # not one that a scenario was read from
        return 0
