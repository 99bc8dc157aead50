"""The whole fleet in one process: a plain loop over the same cores, without zenoh.

The messages of agents pass through the same codec. The journal and netem take those of the world as they are.

For debugging with pdb, for profiling and sweeps, and as the reference that proves the distributed run right.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import msgpack

from agents.config import AgentConfig
from agents.errors import AgentError, ControllerError
from agents.loop import AgentCore, AgentLoop, Answer
from agents.make_agent import make_agent
from fleet.checks.own_checks import OwnChecks
from fleet.errors import RunBroken
from fleet.execution.clock import GrantPolicy
from fleet.execution.notes import note_text
from fleet.execution.runner import Closing
from fleet.recorder.journal import Journal, JournalSink
from fleet.recorder.start import set_up_otherwise
from fleet.scenario.faults.kind import Kill
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.sections.timeline import MOST_RESTARTS
from netem.draws import salted_seed
from netem.errors import MalformedMessage, OutOfPlace
from netem.faults import NetFault
from netem.lives import Absence
from netem.rounds import Rounds
from netem.wire.codec import decode, encode
from netem.wire.messages import Command, Delivery, Frame, Inbox, Nav, Round, Transmission, WorldFault
from world.errors import WorldError
from world.lockstep import Lockstep, NavTo
from world.plugins.kept_files import KeptFiles, files_are_kept
from world.sea import World

WORLD, NETEM = 0, -1  # who speaks; agents have their positive numbers


class AgentLife(Protocol):
    """One life of an agent: `AgentLoop`, or what stands in its place."""

    @property
    def core(self) -> AgentCore: ...
    @property
    def incarnation(self) -> int: ...
    def nav(self, nav: Nav, /) -> list[Answer]: ...
    def inbox(self, inbox: Inbox, /) -> list[Answer]: ...
    @property
    def waiting(self) -> tuple[Delivery, ...]: ...
    def take_over(self, before: Any, /, *, anew: bool) -> None: ...


MakeLife = Callable[[int, int], AgentLife]  # (incarnation, begin) -> one life of an agent


class InProcess:
    """A `Runner` for one run in this process. A caller that looks at the run in between calls `begin`, `advance` and
    `end` in place of `serve`.
    """

    waiting = ""  # one loop does everything, so no process waits
    started_s = 0.0
    middleware_lost = 0  # there is no middleware here

    def __init__(
        self,
        scenario: Scenario,
        journal: Journal,
        before: InProcess | None = None,
        agents: Mapping[int, MakeLife] | None = None,
        salt: int = 0,
    ) -> None:
        """Make it.

        Args:
            before: a run of the same graph to go on from, which is not used afterwards.
            agents: by vehicle, functions that make an agent in place of the scenario's.
            salt: changes all further draws of world and network; 0: the draws of every run with this seed.
        """
        self._other_agents = agents or {}
        self._kept: KeptFiles = KeptFiles() if before is None else before._kept
        self.scenario, self.journal, self._before = scenario, journal, before
        seed = salted_seed(scenario.seed, salt)
        self._world = Lockstep(replace(scenario.world_config, seed=seed), frame_every=frame_every(scenario))
        self.rounds = Rounds(replace(scenario.netem_config, seed=seed))
        self._loops: dict[int, AgentLife] = {}
        self.told: dict[int, Nav] = {}  # by vehicle, the nav that its agent got last
        self.notes: list[str] = []
        self.deaths: dict[int, list[str]] = {}
        self.closing = Closing()
        self._dead: set[tuple[int, int]] = set()  # (vehicle, life) of agents that ended by themselves
        self._failures: dict[tuple[int, int], ControllerError] = {}  # by tick and vehicle: what ends the run
        self.granted = 0  # ticks below it may have begun
        self._speaker = WORLD  # the sender of the message that is being taken
        self._post: deque[tuple[int, int, bytes]] = deque()  # (from, to, message) for agents

    def serve(self, policy: GrantPolicy, progress: Callable[[], None]) -> None:
        """Run to the end. Raises RunBroken if a core sent what cannot be used; AgentError if an agent failed, and the
        scenario does not go on without it; WorldError if the world failed.
        """
        began = time.monotonic()
        self.begin()
        try:
            while not self._world.finished:
                if not self.advance(policy.until(self.journal.written, time.monotonic() - began)):
                    time.sleep(0.002)  # --speed: nothing to do until the wall clock moves on
                progress()
        finally:
            self.release()
        self.end()

    def to_end(self, progress: Callable[[], None], policy: GrantPolicy | None = None) -> RunBroken | None:
        """As `serve`, as fast as it goes; returns what broke the run. None: it came to its end."""
        try:
            self.serve(policy or GrantPolicy.of(self.scenario), progress)
        except RunBroken as error:
            return error
        except (AgentError, WorldError) as error:
            return RunBroken(str(error))
        return None

    def begin(self) -> None:
        """Make the agents, unless they are there already; nothing moves yet."""
        if self._loops:
            return
        before, self._before = self._before, None
        if before is not None:
            self._take_over(before)
            return
        for i in range(1, self.scenario.vehicles + 1):
            self._loops[i] = self._born(i, 0, 0)

    def advance(self, until: int) -> bool:
        """Grant ticks below `until`, and go so far; returns whether an agent was asked. Raises as `serve`."""
        self.granted = max(self.granted, until)
        try:
            self._from_world(self._world.grant(until))
            moves = bool(self._post)
            self._settle()
        except (MalformedMessage, OutOfPlace) as error:
            raise self._unusable(error) from error
        return moves

    def answer(self, i: int, answers: Sequence[Answer]) -> None:
        """Take what agent i answers now, after it had none when it was asked. Raises as `serve` does."""
        try:
            for answer in answers:
                self._from_agent(i, encode(answer))
            self._settle()
        except (MalformedMessage, OutOfPlace) as error:
            raise self._unusable(error) from error

    def end(self) -> None:
        """Account for what is on the way when the last tick is over."""
        self.journal.links(self.rounds.close(self.scenario.ticks))
        self.closing = Closing(entered=self.rounds.netem.entered)

    def release(self) -> None:
        """End what plants hold; the fleet goes no further."""
        self._world.state.world.close()

    @property
    def world(self) -> World:
        return self._world.state.world

    @property
    def finished(self) -> bool:
        return self._world.finished

    def set_network_faults(self, faults: Sequence[NetFault]) -> bool:
        self.rounds.netem.faults = tuple(faults)
        return True

    def set_world_faults(self, faults: Sequence[WorldFault]) -> None:
        self._world.state.world.faults = tuple(faults)

    def vehicles_without_agent(self) -> list[int]:
        state = self._world.state
        return [i for i in state.ids if state.lacks_agent(i)]

    def end_agents(self, kill: Kill) -> None:
        for absence in kill.absences:
            self._world.state.lives.add(absence)
            self.rounds.lives.add(absence)

    def spare_agents(self, kill: Kill) -> None:
        """Leave out a kill that was planned and has not begun."""
        for absence in kill.absences:
            self._world.state.lives.leave_out(absence)
            self.rounds.lives.leave_out(absence)

    def restart_agent(self, i: int, begin: int | None, tick: int) -> None:
        self._world.state.lives.restart(i, begin, tick)
        self.rounds.lives.restart(i, begin, tick)

    def _settle(self) -> None:
        """Carry what is in the post, until everyone waits for a grant or for an agent that answers later."""
        while self._post:
            self._deliver(*self._post.popleft())
        if self._failures:  # an agent goes on to the next round before the others do: the first in simulated time
            raise self._failures[min(self._failures)]

    def _unusable(self, error: MalformedMessage | OutOfPlace) -> RunBroken:
        who = {WORLD: "the world", NETEM: "netem"}.get(self._speaker, f"agent {self._speaker}")
        return RunBroken(f"{who} sent what cannot be used: {error}")

    def _take_over(self, before: InProcess) -> None:
        """Go on at the tick that another run has come to."""
        tick = self.granted = before.granted
        self._world.take_over(tick, before._world)
        self.rounds.take_over(before.rounds)
        state = self._world.state
        self.journal.take_over(tick, before.journal, state.diverged, state.tumbling)
        for i in self.world.ids:
            loop = self._loops[i] = self._born(i, state.lives.incarnation(i, tick), tick)
            if (known := before.life(i)) is not None:  # otherwise the agent was gone there, and may be there now
                loop.take_over(known, anew=set_up_otherwise(self.scenario, before.scenario, i))

    def write_up(self) -> None:
        """Write all ticks that are over; what netem would report with the next round of them, it reports now."""
        self.journal.write_up(self.granted - 1, self.rounds.netem.settle(self.granted - 1))

    @property
    def can_be_copied(self) -> bool:
        """Whether a copy of this process can go on with the run: no plant holds a process, or the like."""
        return not self.world.holds

    def life(self, i: int) -> AgentLife | None:
        """The present life of agent i; None: it is gone, or begins with the next tick."""
        state, loop = self._world.state, self._loops[i]
        return None if state.lacks_agent(i) or state.incarnation(i) != loop.incarnation else loop

    def _born(self, i: int, incarnation: int, begin: int) -> AgentLife:
        if i in self._other_agents:
            return self._other_agents[i](incarnation, begin)
        scenario = self.scenario
        config = msgpack.unpackb(msgpack.packb(scenario.agent_config(i).to_values()))  # as if over the wire
        with files_are_kept(self._kept):
            agent = make_agent(AgentConfig.from_values(config))
        return AgentLoop(agent, scenario.round_ticks, incarnation=incarnation, begin=begin, ideal=scenario.ideal)

    def _loop(self, i: int, incarnation: int) -> AgentLife:
        if incarnation > self._loops[i].incarnation:
            begin = self._world.state.lives.gaps(i)[incarnation - 1][1]
            assert begin is not None  # otherwise no message would name this life
            self._loops[i] = self._born(i, incarnation, begin)
        return self._loops[i]

    def _died(self, i: int, error: ControllerError) -> None:
        deaths = self.deaths.setdefault(i, [])
        self._note(error.tick, f"agent {i}", f"controller failed: {error}")
        restart = self.scenario.spec.on_death == "restart" and len(deaths) < MOST_RESTARTS
        until = self.scenario.next_round(self.granted) if restart else None
        deaths.append("controller failed")
        self._dead.add((i, self._loops[i].incarnation))
        if until is not None:
            self.rounds.lives.add(Absence(i, until - 1, until))
        self._from_world(self._world.end(i, self._loops[i].incarnation, until))

    def _deliver(self, sender: int, i: int, data: bytes) -> None:
        self._speaker = sender
        message = decode(data)
        assert isinstance(message, Nav | Inbox)
        if (i, message.incarnation) in self._dead:
            return
        try:
            loop = self._loop(i, message.incarnation)
            if isinstance(message, Nav):
                self.told[i] = message
                answers = loop.nav(message)
            else:
                answers = loop.inbox(message)
        except ControllerError as error:
            spec = self.scenario.spec
            if spec.on_controller_error != "die" or spec.on_death == "abort":
                self._failures[error.tick, i] = error
                self._dead.add((i, message.incarnation))
            else:
                self._died(i, error)
            return
        for tick, text in loop.core.take_notes():
            self._note(tick, f"agent {i}", text)
        for answer in answers:
            self._from_agent(i, encode(answer))

    def _from_agent(self, i: int, data: bytes) -> None:
        self._speaker = i
        match decode(data):
            case Command() as command:
                self._from_world(self._world.command(i, command, data))
            case Transmission() as transmission:
                self.rounds.transmission(i, transmission)
                self._exchange()
            case message:
                raise AssertionError(f"no route for {message!r}")

    def _from_world(self, outs: list[NavTo | Round | Frame]) -> None:
        self._speaker = WORLD
        for i, tick, text in self._world.state.notes:
            self._note(tick, f"vehicle {i}", text)
        self._world.state.notes.clear()
        navs = []
        for out in outs:
            if isinstance(out, NavTo):
                navs.append((WORLD, out.id, encode(out.nav)))
            elif isinstance(out, Frame):
                self.journal.frame(out)
            elif not self.scenario.ideal:  # on an ideal network netem does not wait for the world
                self.rounds.round(out)
                self._exchange()
        # First of all: a vehicle goes on as far as it can while what it needs is in the processor's caches.
        self._post.extendleft(reversed(navs))

    def _exchange(self) -> None:
        while (outcome := self.rounds.exchange()) is not None:
            self._speaker = NETEM
            inboxes, report = outcome
            self._post.extend((NETEM, i, encode(inbox)) for i, inbox in inboxes)
            self.journal.links(report)

    def _note(self, tick: int, who: str, text: str) -> None:
        self.notes.append(note_text(tick, self.scenario.tick_ns, who, text))


def start_in_process(
    scenario: Scenario,
    log: JournalSink,
    before: InProcess | None = None,
    *,
    agents: Mapping[int, MakeLife] | None = None,
    salt: int = 0,
    judged: bool = True,
) -> InProcess:
    """Make a run in this process, and its journal, which writes to `log`. The rest is as for `InProcess`. `judged`: the
    user's own checks see everything, too. Raises CheckError if a check in Python cannot be made.
    """
    checks = OwnChecks.from_scenario(scenario, 0 if before is None else before.granted) if judged else None
    return InProcess(scenario, Journal(scenario, log, checks=checks), before, agents, salt)
