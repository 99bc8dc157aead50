"""Which vehicles can talk with each other while faults are active: the sides of a partition."""

from __future__ import annotations

from collections.abc import Iterable

from fleet.checks.api import Facts, Fault, Tick
from fleet.quantities import vehicle_numbers
from fleet.scenario.faults.partitions import partition
from fleet.scenario.sections.graph import reached
from netem.condition import Link
from netem.grammar import parse_selector, select


class Sides:
    """The sides of a fleet, tick by tick: `groups`, each with its vehicles by number, in the order of their first
    vehicles, `since` when [s], and the vehicles that are paused.

    Two vehicles are on one side if links that no `partition`, `down`, `mute` or `deaf` cuts lead from each to the
    other, also through others. A vehicle that is paused or has no agent is on none. Losses by the condition of a link
    itself do not count.
    """

    def __init__(self, facts: Facts) -> None:
        self._facts = facts
        self._key: tuple[tuple[Fault, ...], tuple[int, ...]] | None = None
        self.groups: tuple[tuple[int, ...], ...] = ()
        self.since = facts.begin
        self.suspended: frozenset[int] = frozenset()

    def update(self, tick: Tick) -> None:
        """Take the faults and the living vehicles of a tick, later than the one before."""
        alive = tuple(vehicle.id for vehicle in tick.vehicles if vehicle.alive)
        if self._key == (tick.faults, alive):
            return
        first, self._key = self._key is None, (tick.faults, alive)
        groups = self._groups(tick.faults, alive)
        if groups != self.groups:
            self.groups = groups
            self.since = self._facts.begin if first else tick.t

    def _groups(self, faults: Iterable[Fault], alive: Iterable[int]) -> tuple[tuple[int, ...], ...]:
        links = set(self._facts.links)
        absent: set[int] = set()
        cut: set[Link] = set()
        down: set[Link] = set()
        for fault in faults:
            kind, _, what = fault.what.partition(" ")
            match kind:
                case "partition":
                    cut |= partition(what, self._facts.vehicles, self._facts.seed, fault.id, self._facts.links)
                case "down":
                    down |= set(select(parse_selector(what), self._facts.links))
                case "hold":
                    links_of = what.removeprefix("{links: ").partition(",")[0]
                    cut |= set(select(parse_selector(links_of), self._facts.links))
                case "up":
                    down -= set(select(parse_selector(what), self._facts.links))
                case "mute" | "deaf":
                    those = set(vehicle_numbers(what))
                    cut |= {link for link in links if link[kind == "deaf"] in those}
                case "pause":
                    absent |= set(vehicle_numbers(what))
        self.suspended = frozenset(absent)
        links -= cut | down
        there = [i for i in alive if i not in absent]
        heard_by: dict[int, list[int]] = {i: [] for i in there}
        for source, target in sorted(links):
            if source in heard_by and target in heard_by:
                heard_by[source].append(target)
        hearers = {i: reached([i], heard_by) for i in there}
        groups = {tuple(j for j in there if j in hearers[i] and i in hearers[j]) for i in there}
        return tuple(sorted(groups))
