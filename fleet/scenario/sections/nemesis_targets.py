"""The targets of a nemesis: the parts of a scenario that determine sensible faults, and whom they are aimed at.

An aim is resolved before the run, from the graph and the faults that are drawn before it:

| aim | what it means |
|---|---|
| any | drawn |
| leader | `nemesis.leader`; else the vehicle that alone follows the reference; else the one with the lowest number |
| hub | the vehicle with the most links, one of these if there are several |
| bridge | a pair of vehicles without whose links the fleet falls apart, while the faults that hold then do |
| speaker | the vehicle that spoke last: whose silence ended last; if none was silent, with tdma the last slot's |

In every round of a network without slots all vehicles speak at once. So the last vehicle to speak is the one with the
latest new beginning: after a fault that made it mute, killed or suspended it, or cut it off.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import cache
from typing import NamedTuple

from fleet.scenario.schema.control import VehicleOverrides
from fleet.scenario.schema.nemesis import Aim
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.graph import neighbours
from netem.condition import Condition, Link

Pair = tuple[int, int]  # two vehicles that share a link in either direction, the lower number first


class NemesisTargets(NamedTuple):
    """A fleet as a nemesis sees it."""

    spec: ScenarioSpec
    links: tuple[Link, ...]
    conditions: dict[Link, Condition]  # the links' own, where one is written and does not change
    clocks: tuple[int, ...] = ()  # vehicles whose clock is set
    navigators: tuple[int, ...] = ()  # vehicles with dead reckoning
    fixed: tuple[int, ...] = ()  # navigators that get fixes

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


MOST_PAIRS = 20_000  # bridges are looked for in a graph with no more pairs


def leader(targets: NemesisTargets) -> int:
    """The vehicle that leads as far as the scenario says."""
    nemesis, followers = targets.spec.nemesis, targets.followers
    if nemesis is not None and nemesis.leader is not None:
        return nemesis.leader
    return followers[0] if len(followers) == 1 else 1


def hubs(targets: NemesisTargets) -> list[int]:
    """The vehicles with the most links, both directions counted."""
    count = dict.fromkeys(range(1, targets.spec.vehicles + 1), 0)
    for src, dst in targets.links:
        count[src] += 1
        count[dst] += 1
    most = max(count.values())
    return [i for i, links in count.items() if links == most]


def available(targets: NemesisTargets) -> list[Aim]:
    """The aims that make sense for a fleet: alone, a vehicle is all of them."""
    return ["any", "leader", "hub", "bridge", "speaker"] if targets.links else ["any"]


@cache
def bridges(pairs: frozenset[Pair]) -> tuple[Pair, ...]:
    """The pairs without which some vehicle is not connected any more with another one, in order.

    Bridges of an undirected graph (R. E. Tarjan, "A note on finding the bridges of a graph", Inf. Proc. Letters 2,
    1974), without recursion.
    """
    if len(pairs) > MOST_PAIRS:
        return ()
    near = neighbours(sorted(pairs))
    order: dict[int, int] = {}
    low: dict[int, int] = {}
    found: list[Pair] = []
    for root in near:
        if root in order:
            continue
        order[root] = low[root] = len(order)
        walk = [(root, 0, iter(near[root]))]
        while walk:
            at, parent, others = walk[-1]
            for other in others:
                if other not in order:
                    order[other] = low[other] = len(order)
                    walk.append((other, at, iter(near[other])))
                    break
                if other != parent:
                    low[at] = min(low[at], order[other])
            else:
                walk.pop()
                if walk:
                    low[parent] = min(low[parent], low[at])
                    if low[at] > order[parent]:
                        found.append((min(at, parent), max(at, parent)))
    return tuple(sorted(found))


def last_slot(targets: NemesisTargets) -> int | None:
    """With tdma the vehicle that has the last slot of a frame; None: there are no slots."""
    acoustic = targets.spec.network.acoustic
    return targets.spec.vehicles if acoustic is not None and acoustic.mac == "tdma" else None


def remaining_pairs(pairs: Iterable[Pair], cut: Collection[Pair], silent: Collection[int]) -> frozenset[Pair]:
    """The pairs that are left where some are cut and some vehicles silent."""
    return frozenset(p for p in pairs if p not in cut and p[0] not in silent and p[1] not in silent)
