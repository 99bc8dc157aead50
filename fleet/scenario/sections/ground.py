"""The input of a nemesis: the parts of a scenario that determine sensible faults and their targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from fleet.scenario.schema.control import VehicleOverrides
from fleet.scenario.schema.faults import FaultSection, NemesisSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.timeline import action, vehicles_of
from netem.condition import Condition, Link

# --- fault limits
# The limits of the faults of a nemesis, whether a seed draws the faults or a guided search changes them.
#
# A protocol is judged by faults that it promises to survive, and a nemesis says which those are:
#
# * `most_silent`: so many vehicles are dead, suspended or mute at once, at most. A fault beyond that is left out.
# * Without a mode the first fault begins at `start`, and each other one `every` after the one before, or later.
# * No fault lasts longer than `for`; in a swarm half of the run, and 5 s if the vehicle goes on with its last command.


SILENT = frozenset({"mute", "kill", "pause"})  # kinds after whose end a vehicle speaks again
HELD = frozenset({"pause", "stuck"})  # kinds during which a vehicle holds its last command
MOST_HELD_NS = 5_000_000_000


class FaultLimits(NamedTuple):
    """The limits."""

    most_silent: int | None = None  # None: any number
    start_ns: int = 0  # when the first one begins, at the earliest
    every_ns: int = 0  # from one beginning to the next, at least
    longest_ns: int | None = None  # None: any length
    longest_held_ns: int | None = None

    @classmethod
    def of(cls, nemesis: NemesisSection, spec: ScenarioSpec) -> FaultLimits:
        """The limits of a nemesis."""
        if nemesis.mode is None:
            assert nemesis.every is not None and nemesis.for_ is not None  # a rule
            start = nemesis.every if nemesis.start is None else nemesis.start
            return cls(nemesis.most_silent, start, nemesis.every, nemesis.for_, nemesis.for_)
        return cls(nemesis.most_silent, nemesis.start or 0, 0, spec.duration // 2, MOST_HELD_NS)

    def longest(self, kind: str) -> int | None:
        """How long a fault of a kind lasts, at most [ns]."""
        return self.longest_held_ns if kind in HELD else self.longest_ns

    def kept(self, faults: Sequence[FaultSection], own: Sequence[FaultSection] = ()) -> list[bool]:
        """Which of some faults are within the limits.

        Args:
            faults: in order of time.
            own: of the scenario. They are never left out, but the vehicles that they silence count.
        """
        silent = [_silence(fault) for fault in own]
        kept, earliest = list[bool](), self.start_ns
        for fault in faults:
            begin, end, who = _silence(fault)
            quiet = {i for at, until, some in silent if at <= begin < until for i in some}
            many = self.most_silent is not None and bool(who) and len(quiet | who) > self.most_silent
            kept.append(not many and begin >= earliest)
            if kept[-1]:
                earliest = begin + self.every_ns
                silent.append((begin, end, who))
        return kept


def _silence(fault: FaultSection) -> tuple[int, float, frozenset[int]]:
    """From when to when a fault silences which vehicles [ns]."""
    who = vehicles_of(fault) if action(fault) in SILENT else ()
    return fault.at, float("inf") if fault.for_ is None else fault.at + fault.for_, frozenset(who)


Pair = tuple[int, int]  # of vehicles that share a link in either direction, the lower number first


class Ground(NamedTuple):
    """A fleet as a nemesis sees it."""

    spec: ScenarioSpec
    links: tuple[Link, ...]
    conditions: dict[Link, Condition]  # the links' own, where one is written and does not change
    clocks: tuple[int, ...] = ()  # vehicles whose clock is set
    navigators: tuple[int, ...] = ()  # vehicles with dead reckoning
    fixed: tuple[int, ...] = ()  # those of them that get fixes

    @property
    def round_ns(self) -> int:
        """The length of a round, and of a tick where the network is ideal."""
        return self.spec.tick if self.spec.network.ideal else self.spec.network.period

    @property
    def pairs(self) -> list[Pair]:
        """The vehicles that share a link, in order."""
        return sorted({(min(link), max(link)) for link in self.links})

    @property
    def followers(self) -> list[int]:
        """The vehicles that follow the reference themselves."""
        given = self.spec.graph.reference
        return list(range(1, self.spec.vehicles + 1)) if given == "all" else sorted(given)


def instruments(choice: VehicleOverrides) -> tuple[bool, bool, bool]:
    """Whether a vehicle's clock is set, whether it navigates by dead reckoning, and whether it gets fixes."""
    navigation = choice.navigation
    reckons = navigation is not None and not navigation.ideal and navigation.trace is None
    fixes = reckons and navigation is not None and any((navigation.gps, navigation.usbl, navigation.lbl))
    return choice.agent is not None and choice.agent.clock is not None, reckons, fixes
