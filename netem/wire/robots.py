"""The zenoh network of one robot that is not ours: what its programs put, ask and announce, and the same of others.

A robot's programs connect to a router of ours, or we join a router that they have. Each robot has a session of its own,
so nothing passes from one robot to another but what somebody hands over here.

Samples of our own puts do not come back, and queries do not loop: subscribers and queryables hear remote sessions only.
"""

from __future__ import annotations

import json
import logging
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from threading import current_thread
from time import monotonic_ns
from typing import Any, NamedTuple

import zenoh

from netem.errors import BusError
from netem.limits import TOKENS
from netem.robot_message import DELETE, PUT, QUERY, REPLY, RobotMessage
from netem.wire.queries import Ticket
from netem.wire.robot_queues import Inlet, Outlet
from netem.wire.session import (
    BASE,
    OTHERS,
    PENDING,
    PENDING_MS,
    UNIVERSAL,
    client_settings,
    listening,
    reason,
    session_of,
)

log = logging.getLogger(__name__)

ROS_TOKENS = "@ros2_lv"
ANY_PORT = ":0"  # what an address ends with whose port the system chooses
_ASK_S = 86_400.0  # the asker has a time-out of its own; the result of a ROS 2 action may take long
_REMOTE = zenoh.Locality.REMOTE

# Robots have gossip, by which the programs of one robot find each other at its router; nothing else leads to others.
_SETTINGS: dict[str, Any] = (
    BASE
    | UNIVERSAL
    | OTHERS
    | {
        "scouting/gossip/enabled": True,
        "transport/unicast/qos/enabled": True,
        # A long message of a program on this host comes in memory that it shares, as at any router. We share none of
        # ours: a full /dev/shm would end us.
        "transport/shared_memory/enabled": True,
        "transport/shared_memory/transport_optimization/enabled": False,
        "transport/link/tx/lease": 10_000,
        "transport/link/tx/queue/size/data": 16,
        # Connections that never log in; zenoh's own 100 keep new programs out for ten seconds.
        "transport/unicast/accept_pending": PENDING,
        "transport/unicast/accept_timeout": PENDING_MS,
    }
)


@dataclass(frozen=True, slots=True)
class RobotEndpoint:
    """The place where a robot's programs meet us: our router (`listen`), or a router of the robot (`connect`)."""

    number: int
    name: str
    listen: str = ""
    connect: str = ""
    config: str = ""  # a file of zenoh's configuration, for TLS and credentials
    silent: bool = False  # nothing of what its programs say here is carried: they have a modem for that


class Token(NamedTuple):
    """A liveliness token of a robot's program appeared or disappeared."""

    robot: int
    key: str
    alive: bool


class Unfit(NamedTuple):
    """A message that found no room on its way to the relay."""

    kind: str
    key: str
    size: int
    to: int | None = None  # the only receiver; None: all neighbours
    ticket: Ticket | None = None  # the query that a reply belongs to


class Linked(NamedTuple):
    """A program of a robot, or its router, connected or went."""

    robot: int
    who: str
    begins: bool


class _Heard(NamedTuple):
    robot: int
    at_ns: int
    what: Any


class _Replied(NamedTuple):
    robot: int
    at_ns: int
    ticket: Ticket
    reply: Any  # None: there will be no more


def check_key(text: str) -> str:
    """The mistake in a key expression, in zenoh's words, or an empty text."""
    try:
        zenoh.KeyExpr(text)
    except zenoh.ZError as error:
        return reason(error)
    return ""


class Robot:
    """The network of one robot.

    Three threads call its methods. A thread of zenoh takes what comes and puts it into the inlet (`_heard` to
    `_announced`). The thread of the relay asks `carries`. All that a slow program could hold up runs on the thread of
    the outlet: `mirror`, `withdraw`, `ask` and `hand`.
    """

    def __init__(self, endpoint: RobotEndpoint, carry: Sequence[str], inlet: Inlet) -> None:
        """Open its session. Raises BusError: the address is in use, nobody answers there, or a file is no configuration
        of zenoh.
        """
        self.number, self.name = endpoint.number, endpoint.name
        self.stayed: Counter[str] = Counter()  # by key: what no expression of `carry` includes, although it meets one
        self.matched: set[int] = set()  # the numbers of the expressions of `carry` that something came on
        self.placed: deque[tuple[str, bytes]] = deque(maxlen=1)  # key and message that say last where it is
        self._inlet, self._put = inlet, inlet.put
        before = _listening_ports() if endpoint.listen.endswith(ANY_PORT) else None
        self._session = _open_session(endpoint)
        # zenoh tells nobody which port the system gave it.
        self.port = None if before is None else next(iter(_listening_ports() - before), None)
        self.outlet = Outlet()
        self._mirrored: dict[str, Any] = {}  # tokens of others that we show here
        self._served: dict[str, tuple[Any, set[str]]] = {}  # services of others by key, with the tokens that say so
        carry = () if endpoint.silent else carry
        # Advanced publishers, as those of transient local topics, answer below their key; ** does not include @.
        below = [f"{key.removesuffix('/**').removesuffix('**')}/**/@adv/**" for key in carry if "@" not in key]
        self._carry = [zenoh.KeyExpr(text) for text in (*carry, *(key.removeprefix("/") for key in below))]
        self._held: list[Any] = []

    def begin(self) -> None:
        """Listen to the robot's programs."""
        session, direct = self._session, _direct
        listener = session.info.declare_transport_events_listener(direct(self._linked), history=True)
        self._held.append(listener)
        for number, key in enumerate(self._carry):
            heard, asked = direct(partial(self._heard, number)), direct(partial(self._asked, number))
            self._held.append(session.declare_subscriber(key, heard, allowed_origin=_REMOTE))
            self._held.append(session.declare_queryable(key, asked, complete=False, allowed_origin=_REMOTE))
        for text in ("**", f"{ROS_TOKENS}/**", *(k for k in map(str, self._carry) if "@" in k)):
            tokens = session.liveliness().declare_subscriber(text, direct(self._announced), history=True)
            self._held.append(tokens)

    def watch(self, key: str, see: Callable[[str, bytes], None], *, token: bool = False) -> None:
        """Listen to a key expression, whether the network carries it or not.

        Args:
            key: the key expression.
            see: gets the key and the payload of each, on a thread of zenoh.
            token: listen to liveliness tokens that appear, in place of messages.
        """
        if token:

            def appeared(sample: Any) -> None:
                if sample.kind == zenoh.SampleKind.PUT:
                    see(str(sample.key_expr), b"")

            tokens = self._session.liveliness().declare_subscriber(key, _direct(appeared), history=True)
            self._held.append(tokens)
            return
        heard = _direct(lambda sample: see(str(sample.key_expr), sample.payload.to_bytes()))
        self._held.append(self._session.declare_subscriber(key, heard, allowed_origin=_REMOTE))

    def follow(self, topic: str) -> None:
        """Listen to the topic that says where the robot is, whether the network carries it or not."""
        for key in (topic, f"*/{topic}/**"):
            placed = _direct(lambda s: self.placed.append((str(s.key_expr), s.payload.to_bytes())))
            self._held.append(self._session.declare_subscriber(key, placed, allowed_origin=_REMOTE))

    @property
    def routers(self) -> list[str]:
        """The zenoh ids of the routers of others that this session is linked with."""
        return [str(zid) for zid in self._session.info.routers_zid()]

    def close(self) -> None:
        self._held.clear()
        self._mirrored.clear()
        self._served.clear()
        self.outlet.close()
        self._session.close()  # type: ignore[no-untyped-call]

    def _heard(self, number: int, sample: Any) -> None:
        if self._takes(number, sample.key_expr):
            self._came(sample, len(sample.payload))

    def _asked(self, number: int, query: Any) -> None:
        # A query on a key that is served comes a second time, to the queryable of that key.
        if str(query.key_expr) not in self._served and self._takes(number, query.key_expr):
            self._came(query, len(query.payload or b""))
        else:
            query.drop()

    def _came(self, what: Any, size: int) -> None:
        item = _Heard(self.number, monotonic_ns(), what)
        self._inlet.offer(item, size, lambda: Unfit(_kind(what), str(what.key_expr), size))

    def _takes(self, number: int, key: Any) -> bool:
        """Whether expression `number` of `carry` passes a message or query on: it is the first one that includes its
        key. A key that is a pattern may meet several, and be included in none.
        """
        self.matched.add(number)
        first = self._includes(key)
        if first is None and not any(carried.intersects(key) for carried in self._carry[:number]):
            self._stay(str(key))
        return first == number

    def _includes(self, key: Any) -> int | None:
        """The number of the first expression of `carry` that includes a key."""
        return next((number for number, carried in enumerate(self._carry) if carried.includes(key)), None)

    def _stay(self, key: str) -> None:
        self.stayed[key if len(self.stayed) < TOKENS.items else ""] += 1

    def _linked(self, event: Any) -> None:
        begins = event.kind == zenoh.SampleKind.PUT
        if not begins:
            self.outlet.lost_link()
        self._put(Linked(self.number, str(event.transport.zid), begins))

    def _announced(self, sample: Any) -> None:
        if current_thread() is not self.outlet.thread:  # it is no token that we show or withdraw
            self._put(Token(self.number, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    def carries(self, token: str) -> bool:
        """Whether others may see a token: that of a node of ROS, or of something whose key the network carries."""
        if not self._carry:
            return False
        key = token
        if token.startswith(f"{ROS_TOKENS}/"):
            found = ros_key(token)
            if found is None:
                return True
            key = found[1]
        try:
            return self._includes(zenoh.KeyExpr(key.partition("/@adv/")[0])) is not None
        except zenoh.ZError:
            return False

    def mirror(self, token: str) -> None:
        """Show a token of another robot, and the service that it stands for, if there is room for it."""
        if token in self._mirrored or len(self._mirrored) >= TOKENS.items:
            return
        try:
            self._mirrored[token] = self._session.liveliness().declare_token(token)
            if service := _service(token):
                if service not in self._served:
                    self._served[service] = self._serve(service), set()
                self._served[service][1].add(token)
        except zenoh.ZError as error:
            log.warning("%s: cannot show the token %s: %s", self.name, token, reason(error))

    def withdraw(self, token: str) -> None:
        """Show a token no more. If a program of this robot has the same one, zenoh did not say so: it does now."""
        shown = self._mirrored.pop(token, None)
        if shown is None:
            return
        service = _service(token)
        try:
            shown.undeclare()
            if service in self._served:
                queryable, tokens = self._served[service]
                tokens.discard(token)
                if not tokens:
                    del self._served[service]
                    queryable.undeclare()
            own = _direct(lambda reply: reply.ok and self._put(Token(self.number, token, True)))
            self._session.liveliness().get(token, own)
        except zenoh.ZError as error:
            log.warning("%s: cannot withdraw the token %s: %s", self.name, token, reason(error))

    def _serve(self, service: str) -> Any:
        # A client of ROS asks complete queryables only, and ours for all keys must not be one: zenoh would ask it
        # in place of the robot's own.
        def asked(query: Any) -> None:
            if str(query.key_expr) == service:
                self._came(query, len(query.payload or b""))
            else:  # a pattern, which comes to the queryables of `carry`, too
                query.drop()

        return self._session.declare_queryable(service, _direct(asked), complete=True, allowed_origin=_REMOTE)

    def ask(self, ticket: Ticket, payload: bytes) -> None:
        """Put a query of another robot to the programs of this one. Raises BusError: the session cannot send it."""
        query, number = ticket.query, self.number
        if query is None:
            return  # the query has ended

        def replied(reply: Any) -> None:
            if reply.ok is None or self._includes(reply.ok.key_expr) is not None:
                size = len((reply.err if reply.ok is None else reply.ok).payload)
                key = str((query if reply.ok is None else reply.ok).key_expr)
                item = _Replied(number, monotonic_ns(), ticket, reply)
                self._inlet.offer(item, size, lambda: Unfit(REPLY, key, size, ticket.asker, ticket))
            else:
                self._stay(str(reply.ok.key_expr))

        def ended() -> None:
            self._put(_Replied(number, monotonic_ns(), ticket, None))

        try:
            self._session.get(
                query.selector,
                zenoh.handlers.Callback(replied, ended, indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=_ASK_S,
                payload=None if query.payload is None else payload,
                encoding=query.encoding,
                attachment=query.attachment,
                allowed_destination=_REMOTE,
            )
        except zenoh.ZError as error:
            raise BusError(f"cannot ask {self.name}: {reason(error)}") from None

    def say(self, key: str, payload: bytes) -> None:
        """Put something of our own, as JSON. Raises BusError: the session cannot send it."""
        try:
            self._session.put(key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)
        except zenoh.ZError as error:
            raise BusError(f"cannot tell {self.name}: {reason(error)}") from None

    def hand(self, message: RobotMessage, payload: bytes) -> None:
        """Hand over what another robot's program put. Raises BusError: the session cannot send it."""
        sample = message.what
        quality = {
            "priority": sample.priority,
            "express": sample.express,
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "attachment": sample.attachment,
            "timestamp": sample.timestamp,
        }
        try:
            if message.kind == DELETE:
                self._session.delete(sample.key_expr, source_info=sample.source_info, **quality)
            elif message.kind == PUT:
                own = {"encoding": sample.encoding, "source_info": sample.source_info}
                self._session.put(sample.key_expr, payload, **own, **quality)
        except zenoh.ZError as error:
            raise BusError(f"cannot hand {message.key} to {self.name}: {reason(error)}") from None


def answer(message: RobotMessage, payload: bytes) -> None:
    """Give a reply that has arrived to the program that asked."""
    ticket, reply = message.what
    query = ticket.query
    if query is None:
        return  # the query has ended
    try:
        if reply.ok is None:
            query.reply_err(payload, encoding=reply.err.encoding)
        elif reply.ok.kind == zenoh.SampleKind.DELETE:
            query.reply_del(reply.ok.key_expr, attachment=reply.ok.attachment, timestamp=reply.ok.timestamp)
        else:
            ok = reply.ok
            query.reply(
                ok.key_expr, payload, encoding=ok.encoding, attachment=ok.attachment, timestamp=ok.timestamp,
                priority=ok.priority, express=ok.express,
            )  # fmt: skip
    except zenoh.ZError:
        return  # who asked is gone


def read(item: _Heard | _Replied) -> RobotMessage | None:
    """A message of its robot, or None at the end of the replies to a query."""
    if isinstance(item, _Replied):
        if item.reply is None:
            return None
        ok = item.reply.ok
        data = (item.reply.err if ok is None else ok).payload.to_bytes()
        key = str(item.ticket.query.key_expr if ok is None else ok.key_expr)
        return RobotMessage(item.robot, REPLY, key, data, item.at_ns, (item.ticket, item.reply), item.ticket.asker)
    what = item.what
    key = str(what.key_expr)
    kind = _kind(what)
    if kind == QUERY:
        data = b"" if what.payload is None else what.payload.to_bytes()
        return RobotMessage(item.robot, QUERY, key, data, item.at_ns, Ticket(what, item.robot))
    return RobotMessage(item.robot, kind, key, what.payload.to_bytes(), item.at_ns, what)


def _kind(what: Any) -> str:
    if isinstance(what, zenoh.Query):
        return QUERY
    return DELETE if what.kind == zenoh.SampleKind.DELETE else PUT


def ros_key(token: str) -> tuple[str, str] | None:
    """The kind of a token of ROS 2 (MP, MS, SS, SC), and the key of its topic or service; None: it is that of a node,
    or none of ROS. https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md
    """
    parts = token.split("/")
    if len(parts) < 12 or parts[0] != ROS_TOKENS or parts[5] not in ("MP", "MS", "SS", "SC"):
        return None
    return parts[5], "/".join([parts[1], parts[9].replace("%", "/").strip("/"), parts[10], parts[11]])


def _service(token: str) -> str:
    """The key of the service that a token of ROS stands for, or an empty text."""
    found = ros_key(token)
    return found[1] if found is not None and found[0] == "SS" else ""


def _direct(handler: Callable[[Any], None]) -> Any:
    """A handler that zenoh calls itself, without a thread in between."""
    return zenoh.handlers.Callback(handler, indirect=False)


def _listening_ports() -> set[int]:
    """The ports of TCP that this process listens on."""
    import psutil  # here, because it is long to load, and few robots have a port that the system chooses

    return {one.laddr.port for one in psutil.Process().net_connections("tcp") if one.status == psutil.CONN_LISTEN}


def _open_session(endpoint: RobotEndpoint) -> zenoh.Session:
    try:
        config = zenoh.Config.from_file(endpoint.config) if endpoint.config else zenoh.Config()
    except zenoh.ZError as error:
        raise BusError(f"{endpoint.name}: {endpoint.config} is no configuration of zenoh ({reason(error)})") from None
    settings = dict(_SETTINGS)
    if endpoint.listen:
        settings |= {"mode": "router", "connect/endpoints": []} | listening([endpoint.listen])
        problem = f"{endpoint.name}: cannot listen on {endpoint.listen}"
    else:
        settings |= {"mode": "client", "listen/endpoints": []} | client_settings([endpoint.connect], None, 5000)
        problem = f"{endpoint.name}: no router answers at {endpoint.connect}"
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return session_of(config)
    except zenoh.ZError as error:
        raise BusError(f"{problem} ({reason(error)})") from None
