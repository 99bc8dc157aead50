"""Which vehicles can talk with each other while faults are active: the sides of a partition."""

from __future__ import annotations

from collections.abc import Iterable

from fleet.checks.api import Facts, Fault, Tick
from fleet.scenario.faults.kind import Part, Surroundings
from fleet.scenario.sections.fault_entry import fault_of
from fleet.scenario.sections.graph import reachable
from fleet.scenario.text.fault_words import entry_of_words
from netem.faults import NetFault, active_faults
from netem.wire.messages import TimedFault, WorldFault


def _parts(fault: Fault, around: Surroundings) -> list[Part]:
    """What the cores do during a fault of the log. Nothing for a kill, since a tick itself says who has an agent, and
    nothing for an event such as a tumble.
    """
    found = fault_of(fault.entry or entry_of_words(fault.what))
    if found is None or found.kind.name == "kill":
        return []
    return found.kind.parts(found.values, TimedFault(fault.id, 0, None), around)


class ReachableGroups:
    """The sides of a fleet, tick by tick: `groups`, each with its vehicles by number, in the order of their first
    vehicles, `since` when [s], and the vehicles that are paused. `links_since` [s]: when the links between them changed
    last, which may leave the sides as they are.

    Two vehicles are on one side if links that no `partition`, `down`, `hold`, `mute` or `deaf` cuts lead from each to
    the other, also through others. A vehicle that is paused or has no agent is on none. Losses by the condition of a
    link itself do not count.
    """

    def __init__(self, facts: Facts) -> None:
        self._facts = facts
        self._key: tuple[tuple[Fault, ...], tuple[int, ...]] | None = None
        self.groups: tuple[tuple[int, ...], ...] = ()
        self._links: frozenset[tuple[int, int]] = frozenset()
        self.since = self.links_since = facts.begin
        self.suspended: frozenset[int] = frozenset()

    def update(self, tick: Tick) -> None:
        """Take the faults and the living vehicles of a tick, later than the one before."""
        alive = tuple(vehicle.id for vehicle in tick.vehicles if vehicle.alive)
        if self._key == (tick.faults, alive):
            return
        first, self._key = self._key is None, (tick.faults, alive)
        groups, links = self._groups(tick.faults, alive)
        now = self._facts.begin if first else tick.t
        if links != self._links:
            self._links, self.links_since = links, now
        if groups != self.groups:
            self.groups, self.since = groups, now

    def _groups(
        self, faults: Iterable[Fault], alive: Iterable[int]
    ) -> tuple[tuple[tuple[int, ...], ...], frozenset[tuple[int, int]]]:
        """The sides, and the links between living vehicles that nothing cuts."""
        links = set(self._facts.links)
        around = Surroundings(self._facts.vehicles, self._facts.seed, tuple(self._facts.links))
        parts = [part for fault in sorted(faults, key=lambda fault: fault.since) for part in _parts(fault, around)]
        net = active_faults(tuple(part for part in parts if isinstance(part, NetFault)), 0)
        absent = {i for part in parts if isinstance(part, WorldFault) and part.kind == "pause" for i in part.vehicles}
        self.suspended = frozenset(absent)
        links -= {*net.cut, *net.hold}
        there = [i for i in alive if i not in absent]
        links = {(a, b) for a, b in links if a not in net.mute and b not in net.deaf and a in there and b in there}
        heard_by: dict[int, list[int]] = {i: [] for i in there}
        for source, target in sorted(links):
            heard_by[source].append(target)
        hearers = {i: reachable([i], heard_by) for i in there}
        groups = {tuple(j for j in there if j in hearers[i] and i in hearers[j]) for i in there}
        return tuple(sorted(groups)), frozenset(links)


Sides = ReachableGroups  # its name until version 1.0, which checks of users import
