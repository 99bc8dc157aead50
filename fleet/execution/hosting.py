"""Which agents share a process, a host: by default none; in a large fleet as many as the scenario says.

A tick of an agent costs 3.6 times less in a host. Three other ways were rejected: threads (the interpreter lock), a
watchdog thread (a law in native code stops it, too), and a key per agent on one session (no fewer wake-ups).

A host that crashed cannot be repaired from inside, so each later life of an agent has a process of its own. It logs in
as its host, because every login costs time at the router. Host and console map a file that says which agent computes,
since a law that hangs can send nothing any more.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from typing import TypeVar

from agents.controllers import BUILT_IN, laws
from fleet.errors import FleetError
from fleet.execution.rendezvous import Rendezvous
from fleet.processes.limits import processors
from fleet.scenario.scenario import Scenario
from netem.clock import Clock
from netem.wire.credentials import agent_role, host_role

Process = TypeVar("Process")
AUTO_ABOVE = 50  # vehicles: fewer have room for a process each
AUTO_MOST = 25  # agents in a process
AUTO_PER_CPU = 2  # hosts at least, so that no processor idles


@dataclass(frozen=True, slots=True)
class Hosting:
    """The hosts of a run, which are processes of several agents in their first life. Later lives have one each."""

    members: tuple[tuple[int, ...], ...] = ()  # the vehicles of each host; host 1 comes first

    def role(self, i: int, incarnation: int = 0) -> str:
        for h, group in enumerate(() if incarnation else self.members, start=1):
            if i in group:
                return host_role(h)
        return agent_role(i)

    def agents(self, role: str) -> tuple[int, ...]:
        """The vehicles whose agents a process began with; none for world and netem."""
        kind, _, number = role.partition("-")
        if not number:
            return ()
        return (int(number),) if kind == "agent" else self.members[int(number) - 1]

    def processes_used(self, scenario: Scenario) -> tuple[int, int]:
        """How many processes of agents the run starts, and how many agents the fullest has."""
        alone = scenario.vehicles - len(scenario.external) - sum(map(len, self.members))
        return len(self.members) + alone, max(map(len, self.members), default=min(1, alone))

    def children(self, by_role: Mapping[str, Process]) -> Mapping[str, Process]:
        """Processes by role; an agent that has none of its own stands for its host."""
        hosts = {h: by_role[role] for h in range(1, len(self.members) + 1) if (role := host_role(h)) in by_role}
        shared = {agent_role(i): child for h, child in hosts.items() for i in self.members[h - 1]}
        return ChainMap(dict(by_role), shared)


def hosting(scenario: Scenario, clock: Clock, rendezvous: Rendezvous | None = None) -> Hosting:
    """How the agents of a run share processes. Raises FleetError: they are to, but not in a run like this."""
    own = [i for i in range(1, scenario.vehicles + 1) if i not in scenario.external]
    most = scenario.spec.agents.per_process
    router = rendezvous is not None and rendezvous.router is not None
    if most == "auto":
        if router or clock is Clock.REAL or len(own) <= AUTO_ABOVE:
            return Hosting()
        # A law of a user's may keep what it knows in its module, or end its process: it shares none unasked.
        known = {i: laws(scenario.controls[i - 1]).items() for i in own}
        ours = [i for i in own if all(law.name in BUILT_IN[kind] for kind, law in known[i])]
        return _share(ours, min(AUTO_MOST, ceil(len(ours) / (AUTO_PER_CPU * processors()))))
    if most > 1 and clock is Clock.REAL:
        raise _refusal(most, "with --clock real an agent that is late would make the others late")
    if most > 1 and router:
        raise _refusal(most, "a router that is there already has a login for each agent, and none for several")
    return _share(own, most)


def _share(own: Sequence[int], most: int) -> Hosting:
    if most <= 1 or not own:
        return Hosting()
    count = ceil(len(own) / most)
    borders = [len(own) * h // count for h in range(count + 1)]
    return Hosting(tuple(tuple(own[a:b]) for a, b in pairwise(borders)))


def _refusal(most: int, why: str) -> FleetError:
    return FleetError(f"agents.per_process: {most}: {why}; --set agents.per_process=1 gives each a process of its own")
