"""The netem process: the network core behind zenoh, in lockstep."""

from __future__ import annotations

import logging
import os
import sys
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from threading import Lock
from typing import Any, Generic, TypeVar

import msgpack
import msgspec
from msgspec.structs import replace

from netem.config import NetemConfig
from netem.errors import MalformedMessage, OutOfPlace
from netem.faults import read_faults
from netem.lives import Absence, Lives
from netem.realtime_rounds import RealtimeRounds
from netem.rounds import Rounds
from netem.wire.bundles import AgentGroups
from netem.wire.bus import Bus, Respond
from netem.wire.codec import encode, expect
from netem.wire.control import read_map
from netem.wire.credentials import NETEM, Members
from netem.wire.keys import Keys, vehicle_of
from netem.wire.mailbox import Mailbox, Probes
from netem.wire.messages import (
    PROTOCOL_VERSION,
    Bundle,
    Delivery,
    Fate,
    Hello,
    Inbox,
    LinkReport,
    Message,
    Pace,
    Receipt,
    Round,
    Transmission,
)
from netem.wire.parts import PART_BYTES, split

log = logging.getLogger(__name__)

R = TypeVar("R", bound=Rounds | RealtimeRounds)

RECORD_BYTES = 80  # a fate or delivery without its payload, generously

_ECHO = encode(Hello(NETEM, 0, 0, PROTOCOL_VERSION, True))


class NetworkProcess(ABC, Generic[R]):
    """Gives messages and control requests to the rounds of a clock and publishes inboxes and reports."""

    def __init__(self, bus: Bus, keys: Keys, config: NetemConfig, rounds: R, members: Members = ()) -> None:
        self._keys, self._round_key = keys, keys.round
        self._hosts = AgentGroups(bus, keys, members, keys.tx)
        self._rounds = rounds
        self._mailbox = Mailbox(bus, NETEM, keys.note(NETEM))
        self._inbox: dict[int, Callable[[bytes], None]] = {i: bus.publisher(keys.rx(i)) for i in config.vehicles}
        self._links = bus.publisher(keys.links)
        self._round_heard = False
        self._round_parts: list[Round] = []  # the parts of a round that is not whole yet
        self._probes = Probes()
        self._counts = {"sent": {"links": 0}, "received": {"round": 0}}
        self._lock = Lock()  # a control request comes on a thread of zenoh
        self._listen(bus, keys)
        bus.token(keys.alive(NETEM))

    @abstractmethod
    def _listen(self, bus: Bus, keys: Keys) -> None:
        """Subscribe to transmissions and rounds, and answer control requests."""

    @abstractmethod
    def serve(self) -> None:
        """Handle one message after the other, until the process is ended."""

    @abstractmethod
    def _from_agent(self, i: int, message: Message) -> None:
        """Take what agent i sent. Raises MalformedMessage or OutOfPlace."""

    @abstractmethod
    def _from_world(self, message: Message) -> None:
        """Take what the world sent. Raises MalformedMessage or OutOfPlace."""

    def _put(self, key: str, data: bytes) -> None:
        try:
            if key == self._round_key:
                self._world_put(data)
            elif host := self._hosts.number(key):
                self._host_put(host, expect(data, Bundle, Hello))
            else:
                self._agent_put(vehicle_of(key), data)
        except (MalformedMessage, OutOfPlace) as error:
            self._mailbox.reject(key, self._rounds.tick, error)

    def _query(self, key: str, data: bytes, respond: Respond) -> None:
        with self._lock:
            try:
                self._control(data, respond)
            except (MalformedMessage, OutOfPlace) as error:
                self._mailbox.reject(key, self._rounds.tick, error)
                respond(msgpack.packb({"error": str(error)}))
            except Exception:  # of ours: it must end this process, as on the main thread, and not this thread alone
                traceback.print_exc()
                sys.stderr.flush()
                os._exit(1)

    def _host_put(self, h: int, message: Message) -> None:
        if isinstance(message, Hello):
            _check_probe(message)
            self._probes.spend(-h)
            self._hosts.greet(h, _ECHO)
            return
        assert isinstance(message, Bundle)
        for part in message.parts:
            try:
                self._hosts.check(h, part.vehicle)
                self._agent_put(part.vehicle, part.message)
            except (MalformedMessage, OutOfPlace) as error:
                self._mailbox.reject(self._keys.tx(part.vehicle), self._rounds.tick, error)

    def _agent_put(self, i: int, data: bytes) -> None:
        message = expect(data, Transmission, Hello, Receipt)
        if i not in self._inbox:
            raise MalformedMessage("tx", f"no vehicle {i} in this run")
        if isinstance(message, Transmission) and (longest := max(map(len, message.payloads), default=0)) > PART_BYTES:
            raise MalformedMessage("tx", f"a payload of {longest} bytes; at most {PART_BYTES} are carried")
        if isinstance(message, Hello):
            _check_probe(message)
            self._probes.spend(i)
            self._inbox[i](_ECHO)
        else:
            self._from_agent(i, message)

    def _world_put(self, data: bytes) -> None:
        message = expect(data, Round, Hello, Pace)
        if isinstance(message, Hello):
            self._round_heard = True
            return
        if isinstance(message, Round):
            self._counts["received"]["round"] += 1
            if (whole := self._whole(message)) is not None:
                self._from_world(whole)
            return
        self._from_world(message)

    def _whole(self, part: Round) -> Round | None:
        self._round_parts.append(part)
        if part.more:
            return None
        parts, self._round_parts = self._round_parts, []
        alive = tuple(i for each in parts for i in each.alive)
        positions = tuple(position for each in parts for position in each.positions)
        return part if len(parts) == 1 else Round(part.tick, alive, positions, part.paused)

    def _hand_out(self, inboxes: list[tuple[int, Inbox]]) -> None:
        hosted: dict[int, list[tuple[int, bytes]]] = {}
        for i, inbox in inboxes:
            host = self._hosts.of(i, inbox.incarnation)
            for deliveries, more in split(inbox.deliveries, _bytes, PART_BYTES):
                data = encode(replace(inbox, more=more, deliveries=tuple(deliveries)))
                if host:
                    hosted.setdefault(host, []).append((i, data))
                else:
                    self._inbox[i](data)
        for host, messages in hosted.items():
            self._hosts.put(host, messages)

    def _report(self, report: LinkReport) -> None:
        for fates, more in split(report.fates, _bytes, PART_BYTES):
            self._counts["sent"]["links"] += 1
            self._links(encode(replace(report, more=more, fates=tuple(fates))))

    def _control(self, data: bytes, respond: Respond) -> None:
        request = read_map(data)
        match request.get("op"):
            case "ready":
                self._links(_ECHO)
                respond(msgpack.packb({"round": self._round_heard}))
            case "waiting":
                respond(msgpack.packb({"tick": self._rounds.tick, "missing": self._rounds.missing}))
            case "faults":
                self._rounds.netem.faults = read_faults(request.get("faults"))
                respond(msgpack.packb({"tick": self._rounds.tick}))
            case "absences":
                # Only the takeover times matter here: messages from an agent's previous life are rejected.
                self._rounds.lives = Lives(_absences(request.get("absences")))
                respond(msgpack.packb({"tick": self._rounds.tick}))
            case "timing":
                respond(msgpack.packb({"timing": self._rounds.timing()}))
            case "close":
                if not isinstance(tick := request.get("tick"), int) or tick < 0:
                    raise MalformedMessage("control", f"expected the last tick, got {tick!r:.40}")
                self._report(self._rounds.close(tick))
                entered = [[*link, *counts] for link, counts in self._rounds.netem.entered.items()]
                values = {"entered": entered, "rejected": dict(self._mailbox.rejected), "counts": self._counts}
                respond(msgpack.packb(values | {"timing": self._rounds.timing()}))
            case other:
                raise MalformedMessage("control", f"no operation {other!r:.40}")


class NetemProcess(NetworkProcess[Rounds]):
    """The network in lockstep: a round is over when everybody has sent."""

    def _listen(self, bus: Bus, keys: Keys) -> None:
        # Transmissions and rounds: an agent owes one at a time.
        self._in = bus.channel(keys.tx("*"), capacity=max(64, 3 * len(self._inbox)))
        bus.answer(keys.ctl(NETEM), self._query)

    def serve(self) -> None:
        """Handle one message after the other, until the process is ended."""
        take = self._in.get
        while True:
            key, data = take()
            with self._lock:
                self._put(key, data)

    def _from_agent(self, i: int, message: Message) -> None:
        if not isinstance(message, Transmission):
            raise MalformedMessage("receipt", "receipts belong to realtime runs")
        self._rounds.transmission(i, message)
        self._exchange()

    def _from_world(self, message: Message) -> None:
        if not isinstance(message, Round):
            raise MalformedMessage("pace", "a pace belongs to realtime runs")
        self._rounds.round(message)
        self._exchange()

    def _exchange(self) -> None:
        while (outcome := self._rounds.exchange()) is not None:
            inboxes, report = outcome
            self._hand_out(inboxes)
            self._report(report)


def _check_probe(hello: Hello) -> None:
    if hello.echo or hello.version != PROTOCOL_VERSION:
        raise MalformedMessage("hello", f"expected a probe of protocol version {PROTOCOL_VERSION}")


def _absences(values: Any) -> list[Absence]:
    try:
        return msgspec.convert(values, list[Absence])
    except msgspec.ValidationError as error:
        raise MalformedMessage("control", f"expected absences: {error!s:.150}") from None


def _bytes(record: Fate | Delivery) -> int:
    return RECORD_BYTES + len(record.payload)
