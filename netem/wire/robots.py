"""The zenoh network of one robot that is not ours: what its programs put, ask and announce, and the same of others.

A robot's programs connect to a router of ours, or we join a router that they have. Each robot has a session of its own,
so nothing passes from one robot to another but what somebody hands over here.

Samples of our own puts do not come back, and queries do not loop: subscribers and queryables hear remote sessions only.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import monotonic_ns
from typing import Any, NamedTuple

import zenoh

from netem.errors import BusError
from netem.relay import DELETE, PUT, QUERY, REPLY, RobotMessage
from netem.wire.session import BASE, OTHERS, UNIVERSAL, client_settings, listening, opened, reason

ROS_TOKENS = "@ros2_lv"
MOST_TOKENS = 10_000  # of one robot that are mirrored
MOST_OPEN = 10_000  # queries that wait for an answer
_ASK_S = 86_400.0  # the asker has a time-out of its own; the result of a ROS 2 action may take long
_REMOTE = zenoh.Locality.REMOTE
Put = Callable[[Any], None]

# Robots have gossip, by which the programs of one robot find each other at its router; nothing else leads to others.
_SETTINGS: dict[str, Any] = (
    BASE
    | UNIVERSAL
    | OTHERS
    | {
        "scouting/gossip/enabled": True,
        "transport/unicast/qos/enabled": True,
        "transport/link/tx/lease": 10_000,
        "transport/link/tx/queue/size/data": 16,
    }
)


@dataclass(frozen=True, slots=True)
class Meeting:
    """The place where a robot's programs meet us: our router (`listen`), or a router of the robot (`connect`)."""

    number: int
    name: str
    listen: str = ""
    connect: str = ""
    config: str = ""  # a file of zenoh's configuration, for TLS and credentials


@dataclass(slots=True, eq=False)
class Ticket:
    """A query of a robot's program that waits for its answers."""

    query: Any  # zenoh's own
    asker: int
    sent: dict[int, int] = field(default_factory=dict)  # replies by robot that went into a link
    arrived: dict[int, int] = field(default_factory=dict)
    ended: set[int] = field(default_factory=set)  # robots of which no reply will come any more


class Token(NamedTuple):
    """A liveliness token of a robot's program appeared or disappeared."""

    robot: int
    key: str
    alive: bool


class Placed(NamedTuple):
    """A message of a topic that says where a robot is."""

    robot: int
    key: str
    payload: bytes


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
    """The network of one robot. A thread of zenoh calls `put` with each message that comes."""

    def __init__(self, access: Meeting, carry: Sequence[str], put: Put) -> None:
        """Open its session. Raises BusError: the address is in use, nobody answers there, or a file is no configuration
        of zenoh.
        """
        self.number, self.name = access.number, access.name
        self._put = put
        self._session = _opened(access)
        self._mirrored: dict[str, Any] = {}  # tokens of others that we show here
        self._served: dict[str, Any] = {}  # services of others, by key
        # Advanced publishers, as those of transient local topics, answer below their key; ** does not include @.
        self._carry = [zenoh.KeyExpr(text) for text in carry]
        self._held: list[Any] = []

    def begin(self) -> None:
        """Listen to the robot's programs."""
        session, direct = self._session, _direct
        listener = session.info.declare_transport_events_listener(direct(self._linked), history=True)
        self._held.append(listener)
        for key in self._expressions():
            self._held.append(session.declare_subscriber(key, direct(self._heard), allowed_origin=_REMOTE))
            asked = direct(self._asked)
            self._held.append(session.declare_queryable(key, asked, complete=False, allowed_origin=_REMOTE))
        for key in ("**", f"{ROS_TOKENS}/**", *(k for k in self._expressions() if "@" in k)):
            tokens = session.liveliness().declare_subscriber(key, direct(self._announced), history=True)
            self._held.append(tokens)

    def watch(self, topic: str) -> None:
        """Listen to the topic that says where the robot is, whether the network carries it or not."""
        for key in (topic, f"*/{topic}/**"):
            placed = _direct(lambda s: self._put(Placed(self.number, str(s.key_expr), s.payload.to_bytes())))
            self._held.append(self._session.declare_subscriber(key, placed, allowed_origin=_REMOTE))

    @property
    def routers(self) -> list[str]:
        """The zenoh ids of the routers of others that this session is linked with."""
        return [str(zid) for zid in self._session.info.routers_zid()]

    def close(self) -> None:
        self._held.clear()
        self._mirrored.clear()
        self._served.clear()
        self._session.close()  # type: ignore[no-untyped-call]

    def _expressions(self) -> list[str]:
        expressions = [str(key) for key in self._carry]
        below = [f"{key.removesuffix('/**').removesuffix('**')}/**/@adv/**" for key in expressions if "@" not in key]
        return expressions + [key.removeprefix("/") for key in below]

    # --- on a thread of zenoh

    def _heard(self, what: Any) -> None:
        self._put(_Heard(self.number, monotonic_ns(), what))

    def _asked(self, query: Any) -> None:
        if str(query.key_expr) in self._served:  # it comes a second time, to the queryable of that key
            query.drop()
        else:
            self._heard(query)

    def _linked(self, event: Any) -> None:
        begins = event.kind == zenoh.SampleKind.PUT
        self._put(Linked(self.number, str(event.transport.zid), begins))

    def _announced(self, sample: Any) -> None:
        key = str(sample.key_expr)
        if key not in self._mirrored:
            self._put(Token(self.number, key, sample.kind == zenoh.SampleKind.PUT))

    # --- on the thread of the relay

    def carries(self, token: str) -> bool:
        """Whether others may see a token: that of a node of ROS, or of something whose key the network carries."""
        key = token
        if token.startswith(f"{ROS_TOKENS}/"):
            found = ros_key(token)
            if found is None:
                return True
            key = found[1]
        try:
            expression = zenoh.KeyExpr(key.partition("/@adv/")[0])
        except zenoh.ZError:
            return False
        return any(carried.intersects(expression) for carried in self._carry)

    def mirror(self, token: str) -> None:
        """Show a token of another robot, and the service that it stands for, if there is room for it."""
        if token in self._mirrored or len(self._mirrored) >= MOST_TOKENS:
            return
        self._mirrored[token] = None  # before it is declared: it comes back to our own subscriber
        self._mirrored[token] = self._session.liveliness().declare_token(token)
        found = ros_key(token)
        if found is not None and found[0] == "SS" and found[1] not in self._served:
            # A client of ROS asks complete queryables only, and ours for all keys must not be one: zenoh would ask it
            # in place of the robot's own.
            asked = _direct(self._heard)
            self._served[found[1]] = self._session.declare_queryable(
                found[1], asked, complete=True, allowed_origin=_REMOTE
            )

    def withdraw(self, token: str) -> None:
        shown = self._mirrored.get(token)
        if shown is None:
            return
        shown.undeclare()
        del self._mirrored[token]
        found = ros_key(token)
        if found is not None and found[0] == "SS" and found[1] in self._served:
            self._served.pop(found[1]).undeclare()

    def ask(self, ticket: Ticket, payload: bytes) -> None:
        """Put a query of another robot to the programs of this one. Raises BusError: the session cannot send it."""
        query, number, put = ticket.query, self.number, self._put

        def replied(reply: Any) -> None:
            put(_Replied(number, monotonic_ns(), ticket, reply))

        def ended() -> None:
            put(_Replied(number, monotonic_ns(), ticket, None))

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
    if isinstance(what, zenoh.Query):
        data = b"" if what.payload is None else what.payload.to_bytes()
        return RobotMessage(item.robot, QUERY, key, data, item.at_ns, Ticket(what, item.robot))
    kind = DELETE if what.kind == zenoh.SampleKind.DELETE else PUT
    return RobotMessage(item.robot, kind, key, what.payload.to_bytes(), item.at_ns, what)


def ros_key(token: str) -> tuple[str, str] | None:
    """The kind of a token of ROS 2 (MP, MS, SS, SC), and the key of its topic or service; None: it is that of a node,
    or none of ROS. https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md
    """
    parts = token.split("/")
    if len(parts) < 12 or parts[0] != ROS_TOKENS or parts[5] not in ("MP", "MS", "SS", "SC"):
        return None
    return parts[5], "/".join([parts[1], parts[9].replace("%", "/").strip("/"), parts[10], parts[11]])


def _direct(handler: Callable[[Any], None]) -> Any:
    """A handler that zenoh calls itself, without a thread in between."""
    return zenoh.handlers.Callback(handler, indirect=False)


def _opened(access: Meeting) -> zenoh.Session:
    try:
        config = zenoh.Config.from_file(access.config) if access.config else zenoh.Config()
    except zenoh.ZError as error:
        raise BusError(f"{access.name}: {access.config} is no configuration of zenoh ({reason(error)})") from None
    settings = dict(_SETTINGS)
    if access.listen:
        settings |= {"mode": "router"} | listening([access.listen])
        problem = f"{access.name}: cannot listen on {access.listen}"
    else:
        settings |= {"mode": "client"} | client_settings([access.connect], None, 5000)
        problem = f"{access.name}: no router answers at {access.connect}"
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return opened(config)
    except zenoh.ZError as error:
        raise BusError(f"{problem} ({reason(error)})") from None
