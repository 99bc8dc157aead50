"""All of a run that one agent sees, in one session: router, world, netem and console, for a canned exchange."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import msgpack

from netem.errors import MalformedMessage
from netem.wire.bus import Bus, Respond
from netem.wire.certificate_router import CertificateRouter
from netem.wire.codec import decode, encode
from netem.wire.credentials import Credentials, Listener, agent_role
from netem.wire.keys import Keys
from netem.wire.mailbox import Probes
from netem.wire.messages import (
    PROTOCOL_VERSION,
    Command,
    Hello,
    Message,
    Note,
    Transmission,
)

MOST_NOTES = 100
KINDS: dict[str, tuple[type, ...]] = {"cmd": (Hello, Command), "tx": (Hello, Transmission), "note": (Note,)}


class EmulatedFleet:
    """Answers every cfg query and hello of the agent, keeps its notes, and hands out the rest in order."""

    def __init__(
        self,
        endpoint: str,
        keys: Keys,
        vehicle: int,
        user: Credentials,
        private: Path,
        answer: dict[str, Any],
        certified: Listener | None = None,
    ) -> None:
        """Open the router and subscribe to what the agent puts. `private` is a directory of mode 0700, as for
        `Bus.host`; `answer` that to the query of cfg; `certified` where the agent may join with a certificate alone, or
        None. Raises BusError if the endpoint is taken.
        """
        bus = self._bus = Bus.host(endpoint, keys, (vehicle,), {user.user: user}, private)
        self._second = CertificateRouter(bus, keys, (vehicle,), certified) if certified else None
        self._vehicle, self._probes = vehicle, {"cmd": Probes(), "tx": Probes()}
        came: SimpleQueue[tuple[str, bytes]] = SimpleQueue()
        put = came.put
        self._came = came
        self.here = False  # whether the agent holds its token
        self.notes: list[str] = []  # texts of the agent's Note messages
        packed = msgpack.packb(answer)

        def receive(key: str, data: bytes) -> None:
            kind = key.split("/")[-2]
            if kind in KINDS:  # the rest is our own
                put((kind, data))

        def configure(key: str, _: bytes, respond: Respond) -> None:
            respond(packed)
            put(("cfg", b""))

        # Starred as in a run: the router tells an agent of subscribers by their own expression.
        for key in (keys.cmd("*"), keys.tx("*")):
            bus.subscribe(key, lambda *_: None)
        # Both in one, because only what one subscriber gets comes in the order in which it was put.
        bus.subscribe(keys.every(vehicle), receive)
        bus.subscribe(keys.note("*"), lambda _, data: put(("note", data)))
        bus.answer(keys.cfg("*"), configure)
        token = keys.alive(agent_role(vehicle))
        bus.watch_tokens(token, lambda _, alive: put(("token", b"1" if alive else b"")))
        self.nav: Callable[[bytes], None] = bus.publisher(keys.nav(vehicle))
        self.rx: Callable[[bytes], None] = bus.publisher(keys.rx(vehicle))

    def take(self, timeout_s: float) -> tuple[str, Message | None] | None:
        """The next thing that came: `cmd` or `tx` with a message, `cfg` or `token` with none; None when nothing did.
        Raises MalformedMessage if the agent put what does not belong on that key; OutOfPlace if it sends hello more
        often than world and netem would answer.
        """
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0:
            try:
                key, data = self._came.get(timeout=left)
            except Empty:
                break
            if key == "cfg":
                return key, None
            if key == "token":
                self.here = bool(data)
                return key, None
            message = decode(data)
            if not isinstance(message, KINDS[key]):
                raise MalformedMessage(key, f"a {type(message).__name__.lower()} on {key}")
            if isinstance(message, Note):
                if len(self.notes) < MOST_NOTES:
                    self.notes.append(message.text)
                continue
            if isinstance(message, Hello) and not message.echo:
                self._probes[key].spend(self._vehicle)
                role, echo = ("world", self.nav) if key == "cmd" else ("netem", self.rx)
                echo(encode(Hello(role, 0, 0, PROTOCOL_VERSION, True)))
            return key, message
        return None

    def close(self) -> None:
        if self._second is not None:
            self._second.close()
        self._bus.close()
