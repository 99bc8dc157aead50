"""External agents, which are started outside of the run: a join file for each, which of them joined, which are awaited.

There is no child process to watch, so an external agent is present as long as its liveliness token is. It is ready when
the world has heard its last hello, too. In place of a signal it gets a message behind the last of its navs. Its join
file, and the answer when it asks for a configuration, give the number of its life and the first tick of it.
"""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from agents.join_file import JoinFile
from fleet.errors import FleetError, RunBroken
from fleet.execution.directory import RunDirectory
from fleet.execution.gateways import Gateways
from fleet.execution.rendezvous import JoinFolder
from fleet.scenario.scenario import Scenario
from netem.wire.credentials import Credentials, agent_role
from netem.wire.keys import Keys
from netem.wire.messages import PROTOCOL_VERSION


def refuse(scenario: Scenario, what: str, *, stacks: bool = False) -> None:
    """Raise FleetError for a scenario with nodes, which `fleet netem` runs, or with external agents, which join
    distributed runs alone; `what` is refused. `stacks`: it can be made of nodes whose programs the run starts.
    """
    if scenario.nodes and stacks:
        if not scenario.spec.programs:
            raise FleetError(
                f"{scenario.name} has nodes without programs, and {what} starts them: name some in programs"
            )
        if not scenario.ends:
            raise FleetError(f"{scenario.name} runs until it is stopped, and {what} waits for its end: give a duration")
        return
    if scenario.nodes:
        instead = "" if scenario.spec.programs is None else "; fleet sweep --seeds N counts how often a check fails"
        problem = f"{scenario.name} has nodes, whose programs are not ours: fleet netem runs it, but not {what}"
        raise FleetError(problem + instead)
    if stacks and has_gateways(scenario):
        return
    if scenario.external:
        raise FleetError(
            f"{describe_external(scenario.external)}: {what} cannot have agents that are started elsewhere; "
            "set external: false there to run ours"
        )


def uses_wall_clock(scenario: Scenario) -> bool:
    """Whether programs outside of simulated time take part, which the run starts: no two runs of it are the same."""
    return bool(scenario.nodes) or has_gateways(scenario)


def has_gateways(scenario: Scenario) -> bool:
    """Whether some agents are real computers, and the run starts all that join it."""
    external = [its for its in scenario.controls if its.external]
    return bool(external) and all(its.gateway is not None for its in external)


def describe_external(vehicles: Sequence[int]) -> str:
    if len(vehicles) == 1:
        return f"vehicle {vehicles[0]} is external"
    return f"vehicles {', '.join(map(str, vehicles[:-1]))} and {vehicles[-1]} are external"


class ExternalAgents:
    """Which external agents have joined. Everything happens on the console's main thread, except for `answer`."""

    def __init__(self, scenario: Scenario, directory: RunDirectory, print_line: Callable[[str], None]) -> None:
        """Prepare it; nothing is written. `print_line` shows the operator whom the run waits for."""
        self.vehicles = scenario.external
        self._scenario, self._directory, self._print_line = scenario, directory, print_line
        self._files: dict[int, JoinFile] = {}
        self._folders: Mapping[int, JoinFolder] = {}
        self._awaited: dict[int, JoinFile] = {}
        self._present: set[int] = set()  # vehicles whose agent holds its token
        self._gateways = Gateways(scenario, directory, print_line)  # agents that the run starts after all

    @property
    def awaited(self) -> list[int]:
        """The vehicles whose agent is awaited, ascending."""
        return sorted(self._awaited)

    def open(
        self, endpoint: str, keys: Keys, credentials: Mapping[str, Credentials], folders: Mapping[int, JoinFolder]
    ) -> None:
        """Write the join files; from now on the agents may join. `credentials`: by role. `folders`: with what agents
        join that have a certificate and no password, by vehicle. Raises FleetError if a join file cannot be written.
        """
        self._keys, self._folders = keys, folders
        for i in self.vehicles:
            known = credentials[agent_role(i)]
            self._files[i] = JoinFile(endpoint, keys.run, i, **known.to_values(), scenario=self._scenario.name)
            self.expect(i, 0, 0)

    def expect(self, i: int, incarnation: int, begin: int) -> None:
        """Wait for the agent of vehicle i: write its join file. Raises FleetError: it cannot be written."""
        path, folder = self._directory.join(i), self._directory.join_folder(i)
        joining = self._files[i] = replace(self._files[i], incarnation=incarnation, begin=begin)
        try:
            joining.write(path)
            if i in self._folders:
                self._folders[i].write(folder, self._keys, incarnation, begin)
        except OSError as error:
            raise FleetError(f"cannot write {error.filename or path}: {error.strerror}") from error
        self._awaited[i] = joining
        if i in self._gateways:
            self._gateways.start(i, path)
            return
        from_tick = f", from tick {begin} on" if begin else ""
        alone = f"; with its certificate alone: {shlex.quote(str(folder))}" if i in self._folders else ""
        self._print_line(
            f"waiting for agent {i} (external){from_tick}: fleet agent --join {shlex.quote(str(path))}{alone}"
        )

    def token(self, i: int, alive: bool) -> None:
        (self._present.add if alive else self._present.discard)(i)

    def present(self, i: int) -> bool:
        """Whether the agent of vehicle i holds its token."""
        return i in self._present

    def note_ready(self, ready: Iterable[int]) -> None:
        """Record that the world heard these agents. The agents among them that hold their token have joined."""
        for i in sorted(set(ready) & self._awaited.keys() & self._present):
            self.on_joined(i)

    def on_joined(self, i: int) -> None:
        if self._awaited.pop(i, None) is not None:
            self._print_line(f"agent {i} (external) has joined")

    def answer(self, i: int) -> dict[str, Any]:
        """The part of the answer to agent i behind its configuration: the number of its life, or the reason why it
        cannot join.
        """
        awaited = self._awaited.get(i)
        if awaited is None:
            return {"error": f"the run does not wait for an agent {i}: one has joined already, or it has none now"}
        if i in self._present:
            return {"error": f"an agent {i} is here already"}
        return {"incarnation": awaited.incarnation, "begin": awaited.begin, "version": PROTOCOL_VERSION}

    def waiting(self, waited_s: float, most_s: float) -> str:
        """Whom the run waits for, in words. Raises RunBroken: they did not join within `most_s`."""
        names = ", ".join(f"agent {i} (external)" for i in self.awaited[:8])
        names += f" and {len(self._awaited) - 8} more" if len(self._awaited) > 8 else ""
        if failed := self._gateways.failure():
            raise RunBroken(failed)
        if waited_s > most_s:
            raise RunBroken(f"{names} did not join within {most_s:g} s; --join-timeout gives more time")
        return f"waiting for {names} to join, {waited_s:.0f} s"

    def close(self) -> None:
        self._gateways.close()
        for i in self._files:
            self._directory.join(i).unlink(missing_ok=True)
            shutil.rmtree(self._directory.join_folder(i), ignore_errors=True)
