"""A process of one agent or of several: connects, asks for the configuration, and answers navs."""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from pathlib import Path
from socket import socket
from time import monotonic, sleep
from typing import Any

from agents.config import AgentConfig
from agents.errors import AgentError
from agents.loop import AgentCore, AgentLoop, RealtimeLoop
from agents.make_agent import make_agent
from agents.process import READY_TIMEOUT_S, RETRY_S, AgentProcess, OneAgent, Running, give_up, knock
from netem.errors import BusError, MalformedMessage, OutOfPlace
from netem.vehicle_clock import Clock
from netem.wire.access import NETEM, WORLD, Credentials, agent_role, host_role
from netem.wire.bundles import bundles
from netem.wire.bus import Bus
from netem.wire.codec import encode, expect
from netem.wire.keys import Keys
from netem.wire.messages import (
    PROTOCOL_VERSION,
    Bundle,
    BundlePart,
    End,
    Ended,
    Hello,
    Inbox,
    Nav,
    Receipt,
    Transmission,
)
from netem.wire.queues import Stamped
from netem.wire.session import quiet_zenoh
from netem.wire.shell import Shell, end_with_link, read_map
from netem.wire.vehicle_bus import AgentEnd
from world.errors import PluginError

# --- host: one process, and one session, for several agents in lockstep
# Each agent has its own core, loop and life. Their messages come together, and so do their answers, because a fleet of
# a thousand processes spends its time on waking them.


class HostProcess:
    """Passes what comes in to its agents and publishes what comes out."""

    def __init__(self, bus: Bus, keys: Keys, number: int, agents: Iterable[OneAgent], running: Running) -> None:
        """Connect; the agents are ready to be asked. `number`: of the host, from 1. `running`: receives the number of
        the agent that computes.
        """
        role = host_role(number)
        self._bus, self._number, self._running = bus, number, running
        self._alive = keys.alive(role)
        self._agents = {agent.vehicle: agent for agent in agents}
        self._cmd, self._tx, self._note = (bus.publisher(key(role)) for key in (keys.cmd, keys.tx, keys.note))
        self._key = keys.host(number)
        # Navs and inboxes come in one channel: of two, the one that is not looked at could hold back the other.
        self._in = bus.channel(self._key, capacity=max(64, 3 * len(self._agents)))
        self._to_world: list[BundlePart] = []
        self._to_netem: list[BundlePart] = []

    def get_ready(self) -> None:
        """Probe until world and netem have both answered, then declare the agents ready. Raises BusError if one of them
        does not answer.
        """
        probe = encode(Hello("host", self._number, 0, PROTOCOL_VERSION, False))
        knock(probe, {WORLD: self._cmd, NETEM: self._tx}, self._heard)
        ready = [
            BundlePart(i, encode(Hello("agent", i, agent.loop.incarnation, PROTOCOL_VERSION, True)))
            for i, agent in self._agents.items()
        ]
        for data in bundles(ready):
            self._cmd(data)
        self._bus.token(self._alive)

    def _heard(self, _: list[str]) -> list[str]:
        heard = []
        while (item := self._in.poll()) is not None:
            message = expect(item[1], Hello)
            assert isinstance(message, Hello)
            heard.append(message.role)
        return heard

    def serve(self) -> None:
        """Answer one bundle after the other, until the process is ended."""
        take, poll, running = self._in.get, self._in.poll, self._running
        while True:
            item: tuple[str, bytes] | None = take()
            while item is not None:  # what is there already is answered together
                message = expect(item[1], Bundle, Hello)
                if isinstance(message, Bundle):  # else a late echo of a repeated probe
                    for part in message.parts:
                        self._pass(part)
                item = poll()
            running.at(0)
            self._publish()

    def _publish(self) -> None:
        for parts, put in ((self._to_netem, self._tx), (self._to_world, self._cmd)):
            if parts:
                for data in bundles(parts):
                    put(data)
                parts.clear()

    def _pass(self, part: BundlePart) -> None:
        i = part.vehicle
        agent = self._agents.get(i)
        if agent is None:
            return
        try:
            message = expect(part.message, Nav, Inbox, End)
        except MalformedMessage as error:
            agent.shell.reject(self._key, agent.loop.tick, error)
            return
        if isinstance(message, End):
            if agent.is_over(message):
                del self._agents[i]
            return
        self._running.at(i)
        try:
            answers = agent.take(self._key, message)
        except SystemExit as ended:
            self._lose(i, ended.code if isinstance(ended.code, int) else 1)
        except Exception:
            traceback.print_exc()
            self._lose(i, 1)
        else:
            for answer in answers:
                to = self._to_netem if isinstance(answer, (Transmission, Receipt)) else self._to_world
                to.append(BundlePart(i, encode(answer)))

    def _lose(self, i: int, status: int) -> None:
        del self._agents[i]
        self._note(encode(Ended(i, status)))


class RealtimeAgentProcess(AgentProcess):
    """An agent on a wall clock: answers the newest nav that is there, and ends as `AgentProcess` does."""

    def __init__(self, bus: Bus, keys: Keys, vehicle: int, loop: RealtimeLoop) -> None:
        super().__init__(bus, keys, vehicle, loop)
        self._realtime = loop
        self._noted_flood = False

    def _listen(self, bus: Bus, key: str) -> Stamped:
        self._stamped = bus.stamped(key)
        return self._stamped

    def serve(self) -> End:
        """Answer navs until the world ends this life. If the console started this process, it ends it instead."""
        poll = self._navs.poll
        while True:
            item: tuple[str, bytes] | None = self._navs.get()
            navs = []
            while item is not None:
                message = self._read(*item)
                if isinstance(message, End) and self._agent.is_over(message):
                    return message
                if isinstance(message, Nav):
                    navs.append(message)
                item = poll()
            while (came := self._stamped.poll()) is not None:
                key, data, at_ns = came
                message = self._read(key, data)
                if isinstance(message, Inbox):
                    self._take(key, message, at_ns)
            if self._stamped.flooded and not self._noted_flood:
                self._noted_flood = True
                self._agent.shell.note(
                    self._vehicle, self._loop.tick, "more comes in than it takes: messages are dropped"
                )
            for nav in self._realtime.to_answer(navs) if navs else ():
                self._answer(self._keys.nav(self._vehicle), nav)

    def _read(self, key: str, data: bytes) -> Nav | Inbox | End | Hello | None:
        try:
            message = expect(data, Nav, Inbox, End, Hello)
        except MalformedMessage as error:
            self._agent.shell.reject(key, self._loop.tick, error)
            return None
        assert isinstance(message, (Nav, Inbox, End, Hello))
        return message

    def _take(self, key: str, inbox: Inbox, at_ns: int) -> None:
        try:
            self._realtime.arrive(inbox, at_ns)
        except OutOfPlace as error:
            self._agent.shell.reject(key, self._loop.tick, error)


def run(
    endpoint: str,
    run_id: str,
    vehicle: int,
    credentials: Credentials,
    end: socket | None = None,
    incarnation: int = 0,
    begin: int = 0,
) -> None:
    """Join a run as agent `vehicle` and answer navs, from tick `begin` on, until the process is ended. `end`: of the
    vehicle's bus; None: that is on zenoh. Raises BusError if the run cannot be joined. Passes on whatever the
    controller raised; the console has a note about it by then.
    """
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    end_with_link(bus, credentials)
    values = _ask_config(bus, keys.cfg(vehicle))
    config = AgentConfig.from_values(values["agent"])
    wires = None if end is None else AgentEnd(end, keys.nav(vehicle))
    begin_life(bus, keys, config, incarnation, begin, clock_of(values), end=wires).serve()


def run_host(endpoint: str, run_id: str, number: int, credentials: Credentials, running: Path) -> None:
    """Join a run as host `number`, and answer the navs of its agents in lockstep until the process is ended. `running`:
    a file that says at any time which of them is computing. Raises BusError if the run cannot be joined.
    """
    quiet_zenoh()
    keys = Keys(run_id)
    bus = Bus.connect(endpoint, credentials)
    values = _ask_config(bus, keys.cfg(host_role(number)))
    mark = Running(running)
    agents = []
    for slice_ in values["agents"]:
        config = AgentConfig.from_values(slice_)
        mark.at(config.id)
        core = _core(bus, keys, config, 0)
        loop = AgentLoop(core, config.round_ticks)
        agents.append(OneAgent(bus, keys, config.id, loop))
    mark.at(0)
    process = HostProcess(bus, keys, number, agents, mark)
    process.get_ready()
    process.serve()


def clock_of(values: dict[str, Any]) -> Clock:
    """The clock of the run of a cfg reply, which names it only where it is a wall clock."""
    return Clock(values.get("clock", Clock.LOCKSTEP))


def begin_life(
    bus: Bus,
    keys: Keys,
    config: AgentConfig,
    incarnation: int,
    begin: int,
    clock: Clock,
    core: AgentCore | None = None,
    end: AgentEnd | None = None,
) -> AgentProcess:
    """Make an agent that is ready: world and netem have both answered it. `core` answers samples for a program that is
    not ours and gives no memory; None: the core that `config` names. `end`: of the vehicle's bus; None: that is on
    zenoh. Raises BusError if world or netem does not answer, and SystemExit if a law cannot be made. The console has a
    note about the law by then.
    """
    vehicle = config.id
    core = _core(bus, keys, config, begin) if core is None else core
    m = config.round_ticks
    process: AgentProcess
    if clock is Clock.REAL:
        process = RealtimeAgentProcess(bus, keys, vehicle, RealtimeLoop(core, m, incarnation=incarnation, begin=begin))
    else:
        loop = AgentLoop(core, m, incarnation=incarnation, begin=begin)
        process = AgentProcess(bus, keys, vehicle, loop, end)
    process.get_ready()
    return process


def _core(bus: Bus, keys: Keys, config: AgentConfig, begin: int) -> AgentCore:
    try:
        return make_agent(config)
    except (AgentError, PluginError) as error:
        role = agent_role(config.id)
        give_up(Shell(bus, role, keys.note(role)), config.id, begin, error)


def _ask_config(bus: Bus, key: str) -> dict[str, Any]:
    deadline = monotonic() + READY_TIMEOUT_S
    while monotonic() < deadline:
        answer = bus.ask(key)
        if answer is not None:
            return read_map(answer)
        sleep(RETRY_S)  # the console does not answer yet: zenoh returns at once
    raise BusError(f"the console did not answer on {key} within {READY_TIMEOUT_S:.0f} s")
