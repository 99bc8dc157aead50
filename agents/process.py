"""An agent process: one vehicle's agent in lockstep, connected by zenoh. It has its own slice and nothing else."""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Callable
from functools import cached_property
from time import monotonic, sleep
from typing import NoReturn

from msgspec.structs import replace

from agents.errors import ControllerError
from agents.loop import AgentLoop, Answer
from netem.errors import BusError, MalformedMessage, OutOfPlace
from netem.wire.bus import Bus
from netem.wire.codec import encode, expect
from netem.wire.credentials import NETEM, WORLD, agent_role
from netem.wire.keys import Keys
from netem.wire.mailbox import Mailbox
from netem.wire.messages import PROTOCOL_VERSION, End, Hello, Inbox, Message, Nav, Receipt, Transmission
from netem.wire.queues import PutQueue, Stamped
from netem.wire.vehicle_bus import AgentEnd

log = logging.getLogger(__name__)

READY_TIMEOUT_S = 30.0
# The first wait for an answer to a probe. Each further one is twice as long, or the probes of a thousand agents would
# fill all queues.
RETRY_S = 0.02
RAREST_S = 5.0  # the longest time between two probes
POLLS = 20  # looks at the queues between two probes
CONTROLLER_FAILED = 70  # exit status: a law failed, and the scenario says that the run shall end


class OneAgent:
    """An agent of a process: what comes in goes to its `AgentLoop`; what is wrong goes to the console."""

    def __init__(self, bus: Bus, keys: Keys, vehicle: int, loop: AgentLoop) -> None:
        self._bus, self._keys, self.vehicle, self.loop = bus, keys, vehicle, loop

    @cached_property
    def mailbox(self) -> Mailbox:
        """The mailbox for notes, made at the first: most agents never write one."""
        role = agent_role(self.vehicle)
        return Mailbox(self._bus, role, self._keys.note(role))

    @property
    def hello(self) -> Hello:
        return Hello("agent", self.vehicle, self.loop.incarnation, PROTOCOL_VERSION, False)

    def is_over(self, end: End) -> bool:
        """Whether this life is over, and not only the one before it."""
        return end.incarnation >= self.loop.incarnation

    def take(self, key: str, message: Message) -> list[Answer]:
        """Pass a nav or an inbox on; a late echo of a repeated probe needs no answer. Raises SystemExit if a law
        failed, and the agent is to end then. What the controller raised passes on; the console has a note about it by
        then.
        """
        try:
            if isinstance(message, Nav):
                out = self._handle(self.loop.nav, message)
            elif isinstance(message, Inbox):
                out = self._handle(self.loop.inbox, message)
            else:
                return []
        except OutOfPlace as error:
            self.mailbox.reject(key, self.loop.tick, error)
            return []
        for tick, text in self.loop.core.take_notes():
            self.mailbox.note(self.vehicle, tick, text)
        return out

    def _handle(self, handle: Callable[..., list[Answer]], message: Nav | Inbox) -> list[Answer]:
        try:
            return handle(message)
        except OutOfPlace:
            raise
        except ControllerError as error:
            give_up(self.mailbox, self.vehicle, error.tick, error)
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            text = f"controller failed: {type(error).__name__}: {error} ({where.filename}:{where.lineno})"
            self.mailbox.note(self.vehicle, self.loop.tick + 1, text)
            raise


class AgentProcess:
    """Passes what comes in to an agent and publishes what comes out."""

    def __init__(self, bus: Bus, keys: Keys, vehicle: int, loop: AgentLoop, end: AgentEnd | None = None) -> None:
        """`end`: of the vehicle's bus; None: that is on zenoh."""
        self._keys, self._vehicle, self._loop, self._bus = keys, vehicle, loop, bus
        self._agent = OneAgent(bus, keys, vehicle, loop)
        self._tx: Callable[[bytes], None] = bus.publisher(keys.tx(vehicle))
        self._cmd: Callable[[bytes], None] = bus.publisher(keys.cmd(vehicle)) if end is None else end.put
        self._navs: PutQueue | AgentEnd = bus.channel(keys.nav(vehicle)) if end is None else end
        self._rx: PutQueue | Stamped = self._listen(bus, keys.rx(vehicle))

    def _listen(self, bus: Bus, key: str) -> PutQueue | Stamped:
        return bus.channel(key)

    def get_ready(self) -> None:
        """Probe until world and netem have both answered on this agent's own keys, then declare this agent ready.
        Raises BusError if one of them does not answer.
        """
        channels = {WORLD: self._navs, NETEM: self._rx}
        probe = self._agent.hello
        probe_until_answered(
            encode(probe),
            {WORLD: self._cmd, NETEM: self._tx},
            lambda awaited: [role for role in awaited if channels[role].poll() is not None],
        )
        self._cmd(encode(replace(probe, echo=True)))
        self._bus.token(self._keys.alive(agent_role(self._vehicle)))

    def serve(self) -> End:
        """Answer navs, one after the other, until the world ends this life; processes of our own are ended instead."""
        agent, loop, inboxes = self._agent, self._loop, self._rx
        assert isinstance(inboxes, PutQueue)
        while True:
            # A nav that cannot be answered yet waits for an inbox; inboxes that come early wait in their channel.
            key, data = (inboxes if loop.waits_for_inbox else self._navs).get()
            try:
                message = expect(data, Nav, Inbox, End, Hello)
            except MalformedMessage as error:
                agent.mailbox.reject(key, loop.tick, error)
                continue
            if isinstance(message, End):
                if agent.is_over(message):
                    return message
            else:
                self._answer(key, message)

    def _answer(self, key: str, message: Message) -> None:
        for answer in self._agent.take(key, message):
            (self._tx if isinstance(answer, (Transmission, Receipt)) else self._cmd)(encode(answer))


def probe_until_answered(
    probe: bytes, puts: dict[str, Callable[[bytes], None]], heard: Callable[[list[str]], list[str]]
) -> None:
    """Probe until everybody has answered. `puts`: who is to answer, and how a probe gets there. `heard`: which of them
    have answered. Raises BusError if one of them does not answer.
    """
    awaited = [*puts]
    deadline = monotonic() + READY_TIMEOUT_S
    patience = RETRY_S
    while awaited:
        for role in awaited:
            puts[role](probe)
        retry = min(deadline, monotonic() + patience)
        while awaited and monotonic() < retry:
            there = heard(awaited)
            awaited = [role for role in awaited if role not in there]
            sleep(patience / POLLS)
        patience = min(2 * patience, RAREST_S)
        if monotonic() >= deadline:
            raise BusError(f"no answer from world and netem within {READY_TIMEOUT_S:.0f} s")


def give_up(mailbox: Mailbox, vehicle: int, tick: int, error: Exception) -> NoReturn:
    """End this process; the reason goes to the console in one line, and to the process log with its traceback."""
    mailbox.note(vehicle, tick, f"controller failed: {error}")
    if error.__cause__ is not None:
        traceback.print_exception(error.__cause__)
    else:
        sys.stderr.writelines(traceback.format_exception_only(error))
    sys.exit(CONTROLLER_FAILED)
