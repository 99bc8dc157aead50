"""The whole fleet in one process: a plain loop over the same cores, through the same codec, without zenoh.

For debugging with pdb, for profiling and sweeps, and as the reference that proves the distributed run right.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping

import msgpack

from agents.config import AgentConfig
from agents.errors import ControllerError
from agents.loop import AgentLoop, Answer
from agents.make_agent import make_agent
from fleet.errors import RunBroken
from fleet.recorder.journal import Journal
from fleet.recorder.snapshot import Start
from fleet.run.clock import Clock
from fleet.run.notes import note_text
from fleet.run.runner import Closing
from fleet.scenario.scenario import Scenario, frame_every
from fleet.scenario.sections.timeline import MOST_RESTARTS
from netem.errors import MalformedMessage, OutOfPlace
from netem.lives import Absence
from netem.rounds import Rounds
from netem.wire.codec import decode, encode
from netem.wire.messages import Command, Frame, Frames, Inbox, LinkReport, Memory, Message, Nav, Round, Transmission
from world.lockstep import Lockstep, NavTo

WORLD, NETEM, CONSOLE = 0, -1, -2  # addresses; agents have their positive numbers

MakeLoop = Callable[[int, int], AgentLoop]  # (incarnation, begin) -> one life of an agent


class InProcess:
    """One run: a `Runner`."""

    waiting = ""  # nobody waits for anybody here
    started_s = 0.0
    middleware_lost = 0  # there is no middleware here

    def __init__(
        self,
        scenario: Scenario,
        journal: Journal,
        start: Start | None = None,
        agents: Mapping[int, MakeLoop] | None = None,
    ) -> None:
        """Prepare a run.

        Args:
            start: where it goes on from another run; None: at its beginning.
            agents: by vehicle, what makes an agent in place of the scenario's.
        """
        self._other_agents = agents or {}
        self._scenario, self._journal, self._begin = scenario, journal, start
        self._world = Lockstep(scenario.world_config, frame_every=frame_every(scenario))
        self.rounds = Rounds(scenario.netem_config)
        self._loops: dict[int, AgentLoop] = {}
        self.notes: list[str] = []
        self.deaths: dict[int, list[str]] = {}
        self.closing = Closing()
        self._dead: set[tuple[int, int]] = set()  # (vehicle, life) of agents that ended by themselves
        self._granted = 0
        self._post: deque[tuple[int, int, bytes]] = deque()  # (from, to, message)

    def serve(self, clock: Clock, progress: Callable[[], None]) -> None:
        """Run to the end.

        Raises:
            RunBroken: a core sent what cannot be used.
            AgentError: an agent failed, and the scenario does not go on without it.
            WorldError: the world failed.
        """
        began = time.monotonic()
        scenario = self._scenario
        for i in range(1, scenario.vehicles + 1):
            self._loops[i] = self._born(i, 0, 0)
        if self._begin is not None:
            self._resume(self._begin)
        while not self._world.finished:
            until = clock.until(self._journal.written, time.monotonic() - began)
            self._granted = max(self._granted, until)
            self._from_world(self._world.grant(until))
            if not self._post:
                time.sleep(0.002)  # --speed: nothing to do until the wall clock moves on
            while self._post:
                sender, receiver, data = self._post.popleft()
                try:
                    self._deliver(sender, receiver, decode(data), data)
                except ControllerError as error:
                    if scenario.spec.on_controller_error != "die" or scenario.spec.on_death == "abort":
                        raise
                    self._died(receiver, error)
                except (MalformedMessage, OutOfPlace) as error:
                    who = f"agent {sender}" if sender > 0 else {WORLD: "the world", NETEM: "netem"}[sender]
                    raise RunBroken(f"{who} sent what cannot be used: {error}") from error
            progress()
        self._journal.links(self.rounds.close(self._scenario.ticks))
        self.closing = Closing(entered=self.rounds.netem.entered)

    def _resume(self, start: Start) -> None:
        snapshot = start.snapshot
        tick = snapshot.tick
        self._world.resume(tick, snapshot.world)
        self.rounds.resume(tick, snapshot.network)
        self._journal.resume(snapshot)
        for i, memory in snapshot.memories.items():
            loop = self._loops[i] = self._born(i, self._world.state.lives.incarnation(i, tick), tick)
            loop.remember(memory, anew=i in start.anew)

    def _born(self, i: int, incarnation: int, begin: int) -> AgentLoop:
        if i in self._other_agents:
            return self._other_agents[i](incarnation, begin)
        scenario = self._scenario
        core = make_agent(_over_the_wire(scenario.agent_config(i)))
        return AgentLoop(
            core,
            scenario.round_ticks,
            incarnation=incarnation,
            begin=begin,
            ideal=scenario.ideal,
            memory_ticks=scenario.memory_ticks,
        )

    def _loop(self, i: int, incarnation: int) -> AgentLoop:
        """The life `incarnation` of agent i, which is made when it is asked for."""
        if incarnation > self._loops[i].incarnation:
            begin = self._world.state.lives.gaps(i)[incarnation - 1][1]
            assert begin is not None  # otherwise no message would name this life
            self._loops[i] = self._born(i, incarnation, begin)
        return self._loops[i]

    def _died(self, i: int, error: ControllerError) -> None:
        """Account for an agent that ended by itself, as its process would have."""
        deaths = self.deaths.setdefault(i, [])
        self._note(error.tick, f"agent {i}", f"controller failed: {error}")
        restart = self._scenario.spec.on_death == "restart" and len(deaths) < MOST_RESTARTS
        until = self._scenario.next_round(self._granted) if restart else 0
        deaths.append("controller failed")
        self._dead.add((i, self._loops[i].incarnation))
        if until:
            self.rounds.lives.add(Absence(i, until - 1, until))
        self._from_world(self._world.end(i, self._loops[i].incarnation, until or None))

    def _send(self, sender: int, receiver: int, message: Message) -> None:
        self._post.append((sender, receiver, encode(message)))

    def _from_world(self, outs: list[NavTo | Round | Frame]) -> None:
        for i, tick, text in self._world.state.notes:
            self._note(tick, f"vehicle {i}", text)
        self._world.state.notes.clear()
        for out in outs:
            if isinstance(out, NavTo):
                self._send(WORLD, out.id, out.nav)
            elif isinstance(out, Frame):
                self._send(WORLD, CONSOLE, Frames((out,)))
            elif not self._scenario.ideal:  # on an ideal network netem does not wait for the world
                self._send(WORLD, NETEM, out)

    def _deliver(self, sender: int, receiver: int, message: Message, data: bytes) -> None:
        match message:
            case Nav() | Inbox() if (receiver, message.incarnation) in self._dead:
                return
            case Nav():
                self._answer(receiver, self._loop(receiver, message.incarnation).nav(message))
            case Inbox():
                self._answer(receiver, self._loop(receiver, message.incarnation).inbox(message))
            case Memory():
                self._world.remember(sender, message)
            case Command():
                self._from_world(self._world.command(sender, message, data))
            case Transmission():
                self.rounds.transmission(sender, message)
                self._exchange()
            case Round():
                self.rounds.round(message)
                self._exchange()
            case Frames():
                for frame in message.frames:
                    self._journal.frame(frame)
            case LinkReport():
                self._journal.links(message)
            case _:
                raise AssertionError(f"no route for {message!r}")

    def _answer(self, i: int, messages: list[Answer]) -> None:
        for tick, text in self._loops[i].core.take_notes():
            self._note(tick, f"agent {i}", text)
        for message in messages:
            self._send(i, NETEM if isinstance(message, Transmission) else WORLD, message)

    def _note(self, tick: int, who: str, text: str) -> None:
        self.notes.append(note_text(tick, self._scenario.tick_ns, who, text))

    def _exchange(self) -> None:
        while (outcome := self.rounds.exchange()) is not None:
            inboxes, report = outcome
            for i, inbox in inboxes:
                self._send(NETEM, i, inbox)
            self._send(NETEM, CONSOLE, report)


def _over_the_wire(config: AgentConfig) -> AgentConfig:
    """The configuration as an agent process would have received it."""
    return AgentConfig.from_values(msgpack.unpackb(msgpack.packb(config.to_values())))
