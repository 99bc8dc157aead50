"""Whether everyone is ready for the first tick."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Readiness:
    """The processes that are ready, at one moment."""

    missing: str  # who is not, in words; empty: everyone is ready
    only_external: bool = False  # nobody is missing but agents that somebody else starts


def readiness(
    world: Mapping[str, Any],
    network: Mapping[str, Any],
    vehicles: Sequence[int],
    awaited: Sequence[int],
    silent: Collection[str],
) -> Readiness:
    """Find out from the answers of world and netem to `ready` which processes are ready.

    A liveliness token only shows that a process lives. These answers show that messages arrive.

    Args:
        world: the world's answer. `ready` has (vehicle, incarnation) of each agent that greeted the world. `grant`
            says that the world hears grants. Empty: no answer.
        network: netem's answer. `round` says that netem hears the world. Empty: no answer.
        vehicles: all vehicles of the fleet, ascending.
        awaited: vehicles with an external agent that has not joined, ascending.
        silent: keys on which the console has heard no greeting.
    """
    ready = {i for i, _ in world.get("ready", ())}.difference(awaited)
    absent = [i for i in vehicles if i not in ready]
    cores = bool(network.get("round") and world.get("grant"))
    if absent:
        missing = "agents " + ", ".join(map(str, absent)) if len(absent) < 9 else f"{len(absent)} agents"
    elif not network.get("round"):
        missing = "netem"
    else:
        missing = ", ".join(sorted(silent)) or ("" if cores else "the clock's key")
    return Readiness(missing, only_external=bool(awaited) and absent == list(awaited) and cores)
