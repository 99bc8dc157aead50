"""The launch of a run: its processes are started, each with its credentials and its part of the scenario."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from socket import socket
from typing import Any

import agents.main
import agents.process
import netem.main
import world.main
from agents.host_progress import running
from fleet.errors import RunBroken
from fleet.execution.directory import RunDirectory
from fleet.execution.external_agents import ExternalAgents
from fleet.execution.hosting import Hosting
from fleet.execution.options import Options
from fleet.execution.rendezvous import Rendezvous
from fleet.execution.wiring import Wiring
from fleet.processes.children import Children, forkserver_death
from fleet.processes.limits import allow_open_files, processors
from fleet.processes.ports import free_port
from fleet.processes.run_folder import RunFolder
from fleet.scenario.scenario import Scenario, frame_every
from netem.clock import Clock
from netem.wire.credentials import LEASE_MS, NETEM, OPERATOR, WORLD, Listener, agent_role, generate, host_role
from netem.wire.keys import Keys
from netem.wire.session import PENDING
from netem.wire.vehicle_bus import Ends

FORKSERVER_S = 0.2  # wait for the end of a fork server that does not answer
# Processes of agents that the world asks at a time; more of them find colder caches, fewer leave processors idle.
ASKED_PER_CPU = 3

Target = tuple[Callable[..., None], tuple[Any, ...]]  # a function that a process runs, and its arguments


class Launch:
    """Starts the processes of one run, each with what it needs."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        wiring: Wiring,
        hosting: Hosting,
        keys: Keys,
        directory: RunDirectory,
        children: Children,
    ) -> None:
        """Choose endpoints, make credentials and the folder of the run's socket; nothing is started. Raises RunBroken
        if the port is taken, or this machine allows too few open files, or has no place for the folder.
        """
        self._scenario, self._options, self._hosting, self._keys = scenario, options, hosting, keys
        self._directory, self._children = directory, children
        self._rendezvous, self._order = wiring.rendezvous or Rendezvous(), wiring.start_order
        everyone = tuple(range(1, scenario.vehicles + 1))
        self.credentials = self._rendezvous.credentials or generate(everyone, hosts=hosting.members)  # by role
        self.joins_router = self._rendezvous.router is not None  # one that is there already; else the world hosts one
        self._listener = self._other_endpoints()
        others = self._listener or self._rendezvous.certified
        allow_open_files(scenario.vehicles, others=PENDING if others else 0)
        self._private = RunFolder()
        # On a wall clock a suspended agent would leave its navs unread, and the world would wait for room. To a host
        # zenoh carries the messages of many agents at once, and sockets besides it cost more than they save.
        self._ends = Ends() if options.clock is Clock.LOCKSTEP and not hosting.members else None
        self.endpoint = self._rendezvous.router or self._private.endpoint  # for the run's own processes

    def admit(self, external: ExternalAgents) -> None:
        """Tell commands and external agents, in files, how to reach this run. Raises FleetError if a file cannot be
        written.
        """
        self._directory.write_connection(
            {
                "endpoint": self.endpoint,
                "run": self._keys.run,
                "scenario": self._scenario.name,
                "pid": os.getpid(),
                **self.credentials[OPERATOR].to_values(),
            }
        )
        meeting = self._rendezvous
        endpoint = meeting.reached or (self._listener.endpoints[0] if self._listener else self.endpoint)
        credentials = {role: meeting.external_credentials(role, known) for role, known in self.credentials.items()}
        external.open(endpoint, self._keys, credentials, meeting.folders)

    def targets(self) -> dict[str, Target]:
        """The function of each process, by role. The processes start in this order."""
        here = self.endpoint, self._keys.run
        network = self._scenario.netem_config, self._options.clock, self._hosting.members
        targets: dict[str, Target] = {WORLD: self._world()}
        targets[NETEM] = netem.main.run, (*here, self.credentials[NETEM], *network)
        for h, role in enumerate(map(host_role, range(1, len(self._hosting.members) + 1)), start=1):
            targets[role] = agents.main.run_host, (*here, h, self.credentials[role], self._private.path / role)
        elsewhere = {*self._scenario.external, *chain(*self._hosting.members)}
        for i in range(1, self._scenario.vehicles + 1):
            if i not in elsewhere:
                targets[agent_role(i)] = self.agent(i)
        return targets if self._order is None else {role: targets[role] for role in self._order(list(targets))}

    def agent(self, i: int, incarnation: int = 0, begin: int = 0) -> Target:
        """The function that an agent's process runs, in the life `incarnation` that begins at tick `begin`."""
        credentials = self.credentials[self._hosting.role(i)]
        life = incarnation, begin, self._private.path / "kept"
        return agents.main.run, (self.endpoint, self._keys.run, i, credentials, self._end(i), *life)

    def _end(self, i: int) -> socket | None:
        """The end of a vehicle's bus for an agent that is about to start; None: the bus is on zenoh."""
        if self._ends is None:
            return None
        try:
            return self._ends.new(i)
        except OSError:  # no descriptor is left; or the world has ended, which its exit explains
            return None

    def computing(self, role: str) -> int:
        """The vehicle whose agent a host computes, or computed when it ended. 0: no vehicle, or not a host."""
        return running(self._private.path / role)

    def start(self, role: str, target: Target) -> None:
        """Start a process, named in `ps` after its role and the scenario. Raises RunBroken: it could not be started."""
        function, arguments = target
        title = f"fleet {role.replace('-', ' ')} [{self._scenario.name}]"
        try:
            self._children.start(role, title, self._directory.process_log(role), function, *arguments)
        except TimeoutError as error:
            raise RunBroken(f"{role} could not be started: {error}") from error
        except (EOFError, OSError) as error:
            why = forkserver_death(FORKSERVER_S) or str(error) or type(error).__name__
            raise RunBroken(f"{role} could not be started: {why}") from error
        finally:
            for one in arguments:
                if isinstance(one, socket):
                    one.close()  # the process has it

    def close(self) -> None:
        """Remove the folder of the run's socket: from now on no process can join."""
        self._private.close()
        if self._ends is not None:
            self._ends.close()

    def _world(self) -> Target:
        scenario = self._scenario
        # An agent elsewhere may take long to answer, and keep the turn of one that would not.
        most_asked = scenario.vehicles if scenario.external else ASKED_PER_CPU * processors()
        setup = world.main.WorldSetup(
            scenario.world_config, frame_every(scenario), self._options.clock, self._options.speed or 1.0, most_asked
        )
        ends = None if self._ends is None else self._ends.of_world
        if self.joins_router:
            return world.main.join, (self.endpoint, self._keys.run, self.credentials[WORLD], setup, ends)
        clients = {role: known for role, known in self.credentials.items() if role != WORLD}
        listening = self._listener, self._rendezvous.certified, self._hosting.members
        return world.main.run, (self.endpoint, self._keys.run, clients, self._private.path, setup, *listening, ends)

    def _other_endpoints(self) -> Listener | None:
        listener = self._rendezvous.listener
        if self._options.port is None or self.joins_router:
            return listener
        loopback = f"tcp/127.0.0.1:{free_port(self._options.port)}"
        if listener is None:
            return Listener((loopback,), LEASE_MS)
        return replace(listener, endpoints=(loopback, *listener.endpoints))
