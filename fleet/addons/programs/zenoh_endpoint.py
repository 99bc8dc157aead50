"""The place where zenoh programs of one agent meet: a router in their simulated time, and the way to other agents.

This is a program of its own, which runs under the library as the agent's program does. It speaks zenoh with the agent's
programs, by the rules of `fleet netem` (`Robot`), and datagrams with the endpoints of other agents. So each put, query
and reply is a packet that the network judges.

    python -m fleet.addons.programs.zenoh_endpoint NUMBER HEARD_BY_ME...
"""

from __future__ import annotations

import select
import socket
import sys
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from functools import partial
from itertools import count
from threading import Lock
from time import monotonic_ns
from types import SimpleNamespace
from typing import Any

import msgpack
import zenoh

from fleet.addons.programs.known_ports import COMMAND_PORT, NAVIGATION_PORT, READY_PORT, WATER_PORT, ZENOH_PORT
from fleet.addons.programs.zenoh_messages import MessageKind
from netem.errors import BusError
from netem.namespaces import address
from netem.robot_message import DELETE, PUT, QUERY, REPLY, RobotMessage
from netem.wire.queries import OpenQueries, Ticket
from netem.wire.robot_queues import Inlet
from netem.wire.robots import Linked, Robot, RobotEndpoint, Token, Unfit, answer, read

OWN = "self/"  # keys below it stay within the vehicle
NAVIGATION, COMMAND = "self/nav", "self/cmd"
TOKENS_S, LEASE_S = 0.5, 2.0  # how often tokens are told, and after which silence they are gone
MOST_DATAGRAM = 60_000
MOST_MESSAGE = 1 << 20
_MOST_PARTS = -(-MOST_MESSAGE // MOST_DATAGRAM)
MOST_UNFINISHED = 64  # messages of several datagrams of which some are missing
_PRIORITIES = {
    each.__int__(): each  # type: ignore[union-attr]
    for each in (
        zenoh.Priority.REAL_TIME, zenoh.Priority.INTERACTIVE_HIGH, zenoh.Priority.INTERACTIVE_LOW,
        zenoh.Priority.DATA_HIGH, zenoh.Priority.DATA, zenoh.Priority.DATA_LOW, zenoh.Priority.BACKGROUND,
    )
}  # fmt: skip
_DATA = next(number for number, each in _PRIORITIES.items() if each == zenoh.Priority.DATA)


class _Straight(Inlet):
    """Where nothing waits: what comes is sent at once, and the network bounds what waits for it."""

    def offer(self, item: Any, size: int, name: Callable[[], Hashable]) -> None:
        self.put(item)


class ZenohEndpoint:
    """The endpoint of one agent. Threads of zenoh, which bring what the agent's own programs say, and the thread that
    hears the water share it.
    """

    def __init__(
        self,
        number: int,
        heard: Sequence[int],
        send: Callable[[bytes, int | None], object],
        *,
        listen: str = f"tcp/[::]:{ZENOH_PORT}",
        carry: Sequence[str] = ("**",),
        command: Callable[[bytes], object] = lambda _: None,
        wake: Callable[[], object] = lambda: None,
    ) -> None:
        """Open the router.

        Args:
            number: of the agent.
            heard: the agents that hear this one's queries, and that it hears.
            send: sends a datagram to the endpoint of an agent, None: of all; called on threads of zenoh, too.
            listen: where programs connect.
            carry: key expressions of what leaves.
            command: gets what programs put on `self/cmd`.
            wake: called when `tick` has to be called soon.
        """
        self._number, self._lock = number, Lock()
        self._send_datagram, self._command, self._wake = send, command, wake
        self._tickets: dict[int, Ticket] = {}
        self._numbers: dict[Ticket, int] = {}
        self._count = count(1)
        self._queries = OpenQueries({number: set(heard)}, self._end_query)
        self._own_tokens: dict[str, None] = {}  # in the order in which they came
        self._tokens_end_ns = 0  # until when the tokens are told though there is none any more
        self._shown: dict[int, set[str]] = {}
        self._heard_ns: dict[int, int] = {}
        self._parts: dict[tuple[int, int], dict[int, bytes]] = {}
        self._robot = Robot(RobotEndpoint(number, f"auv{number}", listen=listen), [*carry], _Straight(self._take))
        self._robot.begin()

    def tick(self, now_ns: int) -> None:
        """Tell the own tokens again, and let those go that nobody tells; every `TOKENS_S`."""
        with self._lock:
            self._tell_tokens()
            self._expire(now_ns)

    def say(self, key: str, payload: bytes) -> None:
        """Put something for the own programs alone."""
        with suppress(BusError):
            self._robot.say(key, payload)

    def close(self) -> None:
        """Close the router."""
        self._robot.close()

    @property
    def busy(self) -> bool:
        """Whether there are tokens, so that `tick` has something to do."""
        return bool(self._own_tokens or self._shown or monotonic_ns() < self._tokens_end_ns)

    def _take(self, item: Any) -> None:
        if isinstance(item, Token):
            with self._lock:
                self._announced(item)
        elif not isinstance(item, Linked | Unfit):
            self._said(item)

    def _said(self, item: Any) -> None:
        message = read(item)
        if message is None:  # no more replies of own programs to a query of another agent
            asker, number = item.ticket.query.name
            self._send([MessageKind.END, number, item.ticket.sent.get(self._number, 0)], asker)
            return
        if message.key.startswith(OWN):
            if message.key == COMMAND and message.kind == PUT:
                self._command(message.payload)
            elif message.kind == QUERY:
                message.what.end()
            return
        what = message.what
        if message.kind in (PUT, DELETE):
            kind = MessageKind.PUT if message.kind == PUT else MessageKind.DELETE
            self._send([kind, message.key, message.payload, *_manner(what)])
        elif message.kind == QUERY:
            query = what.query
            payload = None if query.payload is None else message.payload
            encoding = None if query.encoding is None else str(query.encoding)
            asked = [str(query.selector), payload, encoding, _bytes(query.attachment)]
            with self._lock:
                number = next(self._count)
                self._tickets[number], self._numbers[what] = what, number
                self._queries.begin(what, len(message.payload))
            self._send([MessageKind.QUERY, number, *asked])
        elif message.kind == REPLY:
            ticket, reply = what
            asker, number = ticket.query.name
            ticket.sent[self._number] = ticket.sent.get(self._number, 0) + 1
            failed = reply.ok is None
            sample = reply.err if failed else reply.ok
            how = 2 if failed else int(reply.ok.kind == zenoh.SampleKind.DELETE)
            manner = [str(sample.encoding)] if failed else _manner(sample)
            self._send([MessageKind.REPLY, number, how, message.key, message.payload, *manner], asker)

    def _announced(self, token: Token) -> None:
        if token.alive == (token.key in self._own_tokens) or not self._robot.carries(token.key):
            return
        if token.alive:
            self._own_tokens[token.key] = None
        else:
            del self._own_tokens[token.key]
            self._tokens_end_ns = monotonic_ns() + round(LEASE_S * 1e9)
        self._tell_tokens()
        self._wake()

    def _tell_tokens(self) -> None:
        if self._own_tokens or monotonic_ns() < self._tokens_end_ns:
            self._send([MessageKind.TOKENS, list(self._own_tokens)])

    def _end_query(self, ticket: Ticket) -> None:
        number = self._numbers.pop(ticket, 0)
        self._tickets.pop(number, None)
        ticket.end()

    def _send(self, message: list[Any], to: int | None = None) -> None:
        data = msgpack.packb(message)
        if len(data) > MOST_MESSAGE:
            print(f"a message of {len(data)} bytes is too long: {MOST_MESSAGE} at most", file=sys.stderr)
            return
        if len(data) <= MOST_DATAGRAM:
            self._send_datagram(data, to)
            return
        number, parts = next(self._count), -(-len(data) // MOST_DATAGRAM)
        for i in range(parts):
            part = data[i * MOST_DATAGRAM : (i + 1) * MOST_DATAGRAM]
            self._send_datagram(msgpack.packb([MessageKind.PART, number, i, parts, part]), to)

    def hear(self, src: int, data: bytes) -> None:
        """Take a datagram of the endpoint of another agent."""
        if src == self._number or not data:
            return  # a broadcast comes back, and who wakes us says nothing
        try:
            message = msgpack.unpackb(data)
            if message[0] == MessageKind.PART:
                whole = self._whole(src, *message[1:])
                if whole is None:
                    return
                message = msgpack.unpackb(whole)
            self._handle(src, message)
        except (ValueError, TypeError, IndexError, KeyError, AttributeError, OverflowError, zenoh.ZError, BusError):
            return  # damaged on its way: it is dropped, as UDP and TCP do

    def _whole(self, src: int, number: int, part: int, of: int, data: bytes) -> bytes | None:
        if not 0 <= part < of <= _MOST_PARTS:
            raise ValueError("no such part")
        parts = self._parts.setdefault((src, number), {})
        parts[part] = data
        if len(parts) < of:
            while len(self._parts) > MOST_UNFINISHED:
                del self._parts[next(iter(self._parts))]
            return None
        del self._parts[src, number]
        return b"".join(parts[i] for i in range(of))

    def _handle(self, src: int, message: list[Any]) -> None:
        kind, *rest = message
        robot, now_ns = self._robot, monotonic_ns()
        if kind in (MessageKind.PUT, MessageKind.DELETE):
            key, payload, *manner = rest
            what = _sample(key, *manner)
            robot.hand(
                RobotMessage(src, PUT if kind == MessageKind.PUT else DELETE, key, payload, now_ns, what), payload
            )
        elif kind == MessageKind.QUERY:
            number, selector, payload, encoding, attachment = rest
            query = SimpleNamespace(
                name=(src, number), selector=selector, key_expr=selector.partition("?")[0], payload=payload,
                encoding=encoding and zenoh.Encoding(encoding), attachment=attachment,
            )  # fmt: skip
            robot.ask(Ticket(query, src), payload)
        elif kind == MessageKind.REPLY:
            number, how, key, payload, encoding, *manner = rest
            if (ticket := self._tickets.get(number)) is None:
                return
            if how == 2:
                reply = SimpleNamespace(ok=None, err=SimpleNamespace(encoding=zenoh.Encoding(encoding)))
            else:
                ok = _sample(key, encoding, *manner)
                ok.kind = zenoh.SampleKind.DELETE if how else zenoh.SampleKind.PUT
                reply = SimpleNamespace(ok=ok)
            answer(RobotMessage(src, REPLY, key, payload, now_ns, (ticket, reply)), payload)
            with self._lock:
                self._queries.on_reply(ticket, src)
        elif kind == MessageKind.END:
            number, replies = rest
            with self._lock:
                if (ticket := self._tickets.get(number)) is not None and src not in ticket.ended:
                    self._queries.add_replies(ticket, src, replies)
                    self._queries.on_robot_ended(ticket, src)
        elif kind == MessageKind.TOKENS:
            with self._lock:
                self._heard_ns[src] = now_ns
                self._show(src, set(rest[0]))

    def _show(self, src: int, keys: set[str]) -> None:
        """Show the tokens of another agent as they are now."""
        before = self._shown.get(src, set())
        self._shown[src] = keys
        robot = self._robot
        for key in sorted(keys - before):
            robot.outlet.do(partial(robot.mirror, key))
        others = set().union(*(shown for i, shown in self._shown.items() if i != src))
        for key in sorted(before - keys - others):
            robot.outlet.do(partial(robot.withdraw, key))
        if not keys:
            del self._shown[src]

    def _expire(self, now_ns: int) -> None:
        """Let the tokens go whose agents have not told them for a lease: they died, or cannot be heard."""
        for src in [i for i in self._shown if now_ns - self._heard_ns[i] > LEASE_S * 1e9]:
            self._show(src, set())


def _bytes(payload: Any) -> bytes | None:
    return None if payload is None else payload.to_bytes()


def _manner(sample: Any) -> list[Any]:
    """How something was put: encoding, attachment, priority, express, time stamp. What is usual is left out."""
    stamp = None if sample.timestamp is None else sample.timestamp.to_string_rfc3339_lossy()
    manner = [str(sample.encoding), _bytes(sample.attachment), sample.priority.__int__(), sample.express, stamp]
    usual = [None, None, _DATA, False, None]
    while len(manner) > 1 and manner[-1] == usual[len(manner) - 1]:
        manner.pop()
    return manner


def _sample(
    key: str,
    encoding: str,
    attachment: bytes | None = None,
    priority: int | None = None,
    express: bool = False,
    stamp: str | None = None,
) -> SimpleNamespace:
    return SimpleNamespace(
        key_expr=key, encoding=zenoh.Encoding(encoding), attachment=attachment, express=express, source_info=None,
        priority=_PRIORITIES[_DATA if priority is None else priority],
        timestamp=None if stamp is None else zenoh.Timestamp.parse_rfc3339(stamp),
    )  # fmt: skip


class EndpointProgram:
    """An endpoint as a program of its agent: datagrams are those of its node."""

    def __init__(self, number: int, heard: Sequence[int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.bind(("0.0.0.0", WATER_PORT))
        self._vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle.bind(("127.0.0.1", NAVIGATION_PORT))
        self._endpoint = ZenohEndpoint(number, heard, self._send, command=self._steer, wake=self._wake)

    def _send(self, data: bytes, to: int | None) -> None:
        self._socket.sendto(data, ("255.255.255.255" if to is None else address(to), WATER_PORT))

    def _steer(self, data: bytes) -> None:
        self._socket.sendto(data, ("127.0.0.1", COMMAND_PORT))

    def _wake(self) -> None:
        """Let the thread of the datagrams look at the clock again."""
        self._socket.sendto(b"", ("127.0.0.1", WATER_PORT))

    def serve(self) -> None:
        """Hand over what comes from the water, without an end."""
        endpoint = self._endpoint
        self._socket.sendto(b"", ("127.0.0.1", READY_PORT))
        due_ns = monotonic_ns()
        while True:
            now_ns = monotonic_ns()
            if now_ns >= due_ns:
                due_ns = now_ns + round(TOKENS_S * 1e9)
                endpoint.tick(now_ns)
            left_s = max(0.0, (due_ns - monotonic_ns()) / 1e9) if endpoint.busy else None
            for ready in select.select([self._socket, self._vehicle], [], [], left_s)[0]:
                data, (sender, _) = ready.recvfrom(1 << 16)
                if ready is self._vehicle:
                    endpoint.say(NAVIGATION, data)
                else:
                    endpoint.hear(int.from_bytes(socket.inet_aton(sender)[2:], "big"), data)


def main(number: str, *heard: str) -> None:
    EndpointProgram(int(number), [*map(int, heard)]).serve()


if __name__ == "__main__":
    main(*sys.argv[1:])
