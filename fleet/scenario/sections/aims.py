"""Whom a fault is aimed at: resolved before the run, from the graph and the faults that are drawn before it.

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

from fleet.scenario.schema.nemesis import Aim
from fleet.scenario.sections.ground import Ground, Pair

MOST_PAIRS = 20_000  # of a graph in which bridges are looked for


def leader(ground: Ground) -> int:
    """The vehicle that leads as far as the scenario says."""
    nemesis, followers = ground.spec.nemesis, ground.followers
    if nemesis is not None and nemesis.leader is not None:
        return nemesis.leader
    return followers[0] if len(followers) == 1 else 1


def hubs(ground: Ground) -> list[int]:
    """The vehicles with the most links, both directions counted."""
    count = dict.fromkeys(range(1, ground.spec.vehicles + 1), 0)
    for src, dst in ground.links:
        count[src] += 1
        count[dst] += 1
    most = max(count.values())
    return [i for i, links in count.items() if links == most]


def available(ground: Ground) -> list[Aim]:
    """The aims that make sense for a fleet: alone, a vehicle is all of them."""
    return ["any", "leader", "hub", "bridge", "speaker"] if ground.links else ["any"]


@cache
def bridges(pairs: frozenset[Pair]) -> tuple[Pair, ...]:
    """The pairs without which some vehicle is not connected any more with another one, in order.

    Bridges of an undirected graph (R. E. Tarjan, "A note on finding the bridges of a graph", Inf. Proc. Letters 2,
    1974), without recursion.
    """
    if len(pairs) > MOST_PAIRS:
        return ()
    beside: dict[int, list[int]] = {}
    for a, b in sorted(pairs):
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    order: dict[int, int] = {}
    low: dict[int, int] = {}
    found: list[Pair] = []
    for root in beside:
        if root in order:
            continue
        order[root] = low[root] = len(order)
        walk = [(root, 0, iter(beside[root]))]
        while walk:
            at, parent, others = walk[-1]
            for other in others:
                if other not in order:
                    order[other] = low[other] = len(order)
                    walk.append((other, at, iter(beside[other])))
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


def side(of: int, pairs: Iterable[Pair]) -> set[int]:
    """The vehicles that a vehicle is connected with, itself included."""
    beside: dict[int, list[int]] = {}
    for a, b in pairs:
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    found, left = {of}, [of]
    while left:
        new = [j for j in beside.get(left.pop(), ()) if j not in found]
        found.update(new)
        left += new
    return found


def last_slot(ground: Ground) -> int | None:
    """With tdma the vehicle that has the last slot of a frame; None: there are no slots."""
    acoustic = ground.spec.network.acoustic
    return ground.spec.vehicles if acoustic is not None and acoustic.mac == "tdma" else None


def without(pairs: Iterable[Pair], cut: Collection[Pair], silent: Collection[int]) -> frozenset[Pair]:
    """The pairs that are left where some are cut and some vehicles silent."""
    return frozenset(p for p in pairs if p not in cut and p[0] not in silent and p[1] not in silent)
