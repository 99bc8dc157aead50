"""The input of a nemesis: the parts of a scenario that determine sensible faults and their targets."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from fleet.scenario.schema.control import VehicleOverrides
from fleet.scenario.schema.spec import ScenarioSpec
from netem.condition import Condition, Link

Pair = tuple[int, int]  # of vehicles that share a link in either direction, the lower number first


class NemesisTargets(NamedTuple):
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


def free_name(name: str, taken: Collection[str | None]) -> str:
    """The id of a fault, made longer until no other fault has it."""
    while name in taken:
        name += "x"
    return name


def instruments(choice: VehicleOverrides) -> tuple[bool, bool, bool]:
    """Whether a vehicle's clock is set, whether it navigates by dead reckoning, and whether it gets fixes."""
    navigation = choice.navigation
    reckons = navigation is not None and not navigation.ideal and navigation.trace is None
    fixes = reckons and navigation is not None and any((navigation.gps, navigation.usbl, navigation.lbl))
    return choice.agent is not None and choice.agent.clock is not None, reckons, fixes
