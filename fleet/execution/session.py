"""The console's session on the bus: what it publishes, asks and answers, and the events that it makes of what comes.

The events are in one queue, the console's input. The watcher of processes puts its events there, too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from enum import StrEnum
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

import msgpack

from fleet.errors import RunBroken
from fleet.execution.external_agents import ExternalAgents
from fleet.execution.hosting import Hosting
from fleet.execution.notes import Notes
from fleet.scenario.scenario import Scenario
from netem.clock import Clock
from netem.errors import BusError
from netem.wire.bus import Bus, Respond
from netem.wire.codec import encode
from netem.wire.control import read_map, request
from netem.wire.credentials import Credentials, agent_role, host_role
from netem.wire.keys import Keys
from netem.wire.messages import Frames, Hello, LinkReport, Message

CONNECT_S = 10.0
CONNECT_TRY_MS = 500


class EventKind(StrEnum):
    """The kinds of event, and what comes with each."""

    FRAME = "frame"  # bytes: states from the world
    LINKS = "links"  # bytes: fates of packets from netem
    NOTE = "note"  # (role, bytes)
    EXIT = "exit"  # `Exit`: a process ended
    OPERATION = "operation"  # (bytes, Respond): a request of an operator
    TOKEN = "token"  # (vehicle, bool): the liveliness token of an external agent appeared or disappeared
    ROUTER_LOST = "lost"  # endpoint of the router that is there already: the link to it ended


EXPECTED: dict[EventKind, tuple[type, ...]] = {
    EventKind.FRAME: (Frames, Hello),
    EventKind.LINKS: (LinkReport, Hello),
}


class EventQueue:
    """Events in the order of their arrival. Every thread may `put`; the console's main thread takes."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[tuple[EventKind, Any]] = SimpleQueue()

    def put(self, kind: EventKind, data: Any) -> None:
        self._queue.put((kind, data))

    def take(self, timeout_s: float) -> Iterator[tuple[EventKind, Any]]:
        """The next event and all further events that are there already; wait at most this long for the first."""
        try:
            yield self._queue.get(timeout=max(0.0, timeout_s))
            while True:
                yield self._queue.get_nowait()
        except Empty:
            return

    def take_for(self, duration_s: float) -> Iterator[tuple[EventKind, Any]]:
        """Every event that arrives within so long."""
        deadline = time.monotonic() + duration_s
        while (left_s := deadline - time.monotonic()) > 0:
            yield from self.take(left_s)


def connect_to_world(endpoint: str, credentials: Credentials, meanwhile: Callable[[], None]) -> Bus:
    """Connect to the router that the world is starting. `meanwhile`: called after each attempt that failed; it may
    raise a better explanation. Raises RunBroken if there is no router within `CONNECT_S`.
    """
    deadline = time.monotonic() + CONNECT_S
    while True:
        try:
            return Bus.connect(endpoint, credentials, timeout_ms=CONNECT_TRY_MS)
        except BusError as error:
            meanwhile()
            if time.monotonic() > deadline:
                raise RunBroken(str(error)) from None


def connect_to_router(endpoint: str, credentials: Credentials, keys: Keys, events: EventQueue) -> Bus:
    """Connect to a router that is there already. Raises RunBroken if it does not let us in, or another run uses this
    run's keys there.
    """
    try:
        bus = Bus.connect(endpoint, credentials)
    except BusError as error:
        raise RunBroken(str(error)) from None
    if tokens := bus.tokens(keys.alive("*")):
        bus.close()
        who = ", ".join(token.rsplit("/", 1)[-1] for token in tokens)
        raise RunBroken(
            f"run {keys.run} is going on at {endpoint} already ({who}): end it, or make credentials for "
            "another with fleet hosts acl"
        )
    bus.on_lost(partial(events.put, EventKind.ROUTER_LOST, endpoint))
    return bus


class Session:
    """One session, from the router's answer to the end of the run. It is used on the console's main thread."""

    def __init__(self, bus: Bus, keys: Keys) -> None:
        self._bus, self._keys = bus, keys
        self._publish = bus.publisher(keys.grant)

    def put(self, message: Message) -> None:
        """Publish a message for the world on the key of the grants; zenoh keeps the order."""
        self._publish(encode(message))

    def ask(self, role: str, op: str, *, timeout_s: float = 1.0, **fields: Any) -> dict[str, Any]:
        """Ask world or netem for an operation. Returns the answer; empty: no answer came in time."""
        answer = self._bus.ask(self._keys.ctl(role), request(op, **fields), timeout_s=timeout_s)
        return {} if answer is None else read_map(answer)

    def listen(self, events: EventQueue, notes: Notes) -> None:
        """Turn what arrives from the processes and from operators into events, from now on."""
        keys, put = self._keys, events.put

        def queue_note(key: str, data: bytes) -> None:
            role = key.rsplit("/", 1)[-1]
            if notes.admit(role):
                put(EventKind.NOTE, (role, data))

        self._bus.subscribe(keys.frame, lambda _, data: put(EventKind.FRAME, data))
        self._bus.subscribe(keys.links, lambda _, data: put(EventKind.LINKS, data))
        self._bus.subscribe(keys.note("*"), queue_note)
        self._bus.answer(f"{keys.op}/*", lambda _, data, respond: put(EventKind.OPERATION, (data, respond)))

    def configure(
        self, scenario: Scenario, clock: Clock, hosting: Hosting, external: ExternalAgents, events: EventQueue
    ) -> None:
        """Answer agents, and hosts, that ask for their slice of the scenario, and watch the tokens of external agents.
        Raises PluginError if a law cannot be used.
        """
        known = {} if clock is Clock.LOCKSTEP else {"clock": clock}
        slices = [scenario.agent_config(i).to_values() for i in range(1, scenario.vehicles + 1)]
        vehicles = {self._keys.cfg(i): i for i in range(1, scenario.vehicles + 1)}
        hosts = {self._keys.cfg(host_role(h)): group for h, group in enumerate(hosting.members, start=1)}

        def answer(key: str, _: bytes, respond: Respond) -> None:
            if key in hosts:
                respond(msgpack.packb({"agents": [slices[i - 1] for i in hosts[key]]}))
                return
            i = vehicles[key]
            more = external.answer(i) if i in external.vehicles else {}
            respond(msgpack.packb(more if "error" in more else {"agent": slices[i - 1]} | known | more))

        def queue_token(i: int, _: str, alive: bool) -> None:
            events.put(EventKind.TOKEN, (i, alive))

        self._bus.answer(self._keys.cfg("*"), answer)
        for i in external.vehicles:
            self._bus.watch_tokens(self._keys.alive(agent_role(i)), partial(queue_token, i))

    def close(self) -> None:
        self._bus.close()
