"""An agent process: one vehicle's agent in lockstep, connected by zenoh. It has its own slice and nothing else."""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Callable
from time import monotonic, sleep
from typing import NoReturn

from agents.errors import ControllerError
from agents.loop import AgentLoop, Answer
from netem.errors import BusError, MalformedMessage, OutOfPlace
from netem.wire.access import agent_role
from netem.wire.bus import Bus
from netem.wire.codec import encode, expect
from netem.wire.keys import Keys
from netem.wire.messages import PROTOCOL_VERSION, End, Hello, Inbox, Message, Nav, Receipt, Transmission
from netem.wire.queues import PutQueue, Stamped
from netem.wire.shell import Shell

log = logging.getLogger(__name__)

READY_TIMEOUT_S = 30.0
RETRY_S = 0.02  # and twice as long each further time: the probes of a thousand agents would fill all queues
RAREST_S = 5.0  # between two probes
POLLS = 20  # looks at the queues between two probes
CONTROLLER_FAILED = 70  # exit status: a law failed, and the scenario says that the run shall end


class AgentProcess:
    """Passes what comes in to an `AgentLoop` and publishes what comes out."""

    def __init__(self, bus: Bus, keys: Keys, vehicle: int, loop: AgentLoop) -> None:
        self._keys, self._vehicle, self._loop, self._bus = keys, vehicle, loop, bus
        role = agent_role(vehicle)
        self._shell = Shell(bus, role, keys.note(role))
        self._tx: Callable[[bytes], None] = bus.publisher(keys.tx(vehicle))
        self._cmd: Callable[[bytes], None] = bus.publisher(keys.cmd(vehicle))
        self._navs = bus.channel(keys.nav(vehicle))
        self._rx: PutQueue | Stamped = self._listen(bus, keys.rx(vehicle))

    def _listen(self, bus: Bus, key: str) -> PutQueue | Stamped:
        return bus.channel(key)

    def get_ready(self) -> None:
        """Probe until world and netem have both answered on this agent's own keys, then declare this agent ready.

        Raises:
            BusError: one of them does not answer.
        """
        probe = encode(Hello("agent", self._vehicle, self._loop.incarnation, PROTOCOL_VERSION, False))
        unheard: dict[PutQueue | Stamped, Callable[[bytes], None]] = {self._navs: self._cmd, self._rx: self._tx}
        deadline = monotonic() + READY_TIMEOUT_S
        patience = RETRY_S
        while unheard:
            for put in unheard.values():
                put(probe)
            retry = min(deadline, monotonic() + patience)
            while unheard and monotonic() < retry:
                for channel in [c for c in unheard if c.poll() is not None]:
                    del unheard[channel]
                sleep(patience / POLLS)
            patience = min(2 * patience, RAREST_S)
            if monotonic() >= deadline:
                raise BusError(f"no answer from world and netem within {READY_TIMEOUT_S:.0f} s")
        self._cmd(encode(Hello("agent", self._vehicle, self._loop.incarnation, PROTOCOL_VERSION, True)))
        self._bus.token(self._keys.alive(agent_role(self._vehicle)))

    def serve(self) -> End:
        """Answer navs, one after the other, until the world ends this life; processes of our own are ended instead."""
        loop, inboxes = self._loop, self._rx
        assert isinstance(inboxes, PutQueue)
        while True:
            # A nav that cannot be answered yet waits for an inbox; inboxes that come early wait in their channel.
            key, data = (inboxes if loop.waits_for_inbox else self._navs).get()
            try:
                message = expect(data, Nav, Inbox, End, Hello)
            except MalformedMessage as error:
                self._shell.reject(key, loop.tick, error)
                continue
            if isinstance(message, End):
                if self._is_over(message):
                    return message
            elif not isinstance(message, Hello):  # a late echo of a repeated probe
                self._answer(key, message)

    def _is_over(self, end: End) -> bool:
        """Whether this life is over, and not only the one before it."""
        return end.incarnation >= self._loop.incarnation

    def _answer(self, key: str, message: Message) -> None:
        """Pass a nav or an inbox on, and publish the answers."""
        loop = self._loop
        try:
            if isinstance(message, Nav):
                out = self._handle(loop.nav, message)
            else:
                assert isinstance(message, Inbox)
                out = self._handle(loop.inbox, message)
        except OutOfPlace as error:
            self._shell.reject(key, loop.tick, error)
            return
        for tick, text in loop.core.take_notes():
            self._shell.note(self._vehicle, tick, text)
        for answer in out:
            (self._tx if isinstance(answer, (Transmission, Receipt)) else self._cmd)(encode(answer))

    def _handle(self, handle: Callable[..., list[Answer]], message: Nav | Inbox) -> list[Answer]:
        try:
            return handle(message)
        except OutOfPlace:
            raise
        except ControllerError as error:
            _give_up(self._shell, self._vehicle, error.tick, error)
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            text = f"controller failed: {type(error).__name__}: {error} ({where.filename}:{where.lineno})"
            self._shell.note(self._vehicle, self._loop.tick + 1, text)
            raise


def _give_up(shell: Shell, vehicle: int, tick: int, error: Exception) -> NoReturn:
    """End this process; the reason goes to the console in one line, and to the process log with its traceback."""
    shell.note(vehicle, tick, f"controller failed: {error}")
    if error.__cause__ is not None:
        traceback.print_exception(error.__cause__)
    else:
        sys.stderr.writelines(traceback.format_exception_only(error))
    sys.exit(CONTROLLER_FAILED)
