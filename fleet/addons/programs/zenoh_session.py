"""What stands in for zenoh: sessions whose messages are payloads of the agents, with zenoh's own rules for keys."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from types import ModuleType
from typing import Any

from fleet.addons.programs import zenoh_values
from fleet.addons.programs.standard import stand_in
from fleet.addons.programs.turns import NS, Turns
from fleet.addons.programs.zenoh_values import (
    Callback,
    Channel,
    Encoding,
    FifoChannel,
    MatchingStatus,
    Reply,
    ReplyError,
    RingChannel,
    Sample,
    SampleKind,
    ZBytes,
    ZenohError,
)
from netem.wire.key_expressions import KeyExpression, intersects, key_expression

PUT, DELETE, QUERY, REPLY, FINAL, TOKEN, UNTOKEN = range(7)
QUERY_TIMEOUT_S = 10.0  # zenoh's own: queries_default_timeout
OWN = "self/"  # keys below it stay within the vehicle
NAVIGATION, COMMAND = "self/nav", "self/cmd"
LEASE_NS = 2 * NS  # a token that is not told for so long is gone
Send = Callable[[list[Any]], None]


class Zenoh:
    """The sessions of one program, and what comes for them."""

    def __init__(self, turns: Turns, number: int, hears: frozenset[int], send: Send) -> None:
        """Have no session yet.

        Args:
            turns: the program's threads.
            number: of the agent.
            hears: the agents that it hears, whose answers a query waits for.
            send: takes a message for all that hear this agent.
        """
        self.turns, self.number, self.hears, self.send = turns, number, hears, send
        self.subscribers: list[Subscriber] = []
        self.queryables: list[Queryable] = []
        self.tokens: list[Token] = []
        self.watchers: list[Watcher] = []
        self.queries: dict[int, PendingQuery] = {}
        self.numbers = count(1)
        self.command: Callable[[float, float, float], None] = lambda *_: None  # surge force [N], pitch, yaw [N m]
        self._seen_ns: dict[tuple[int, str], int] = {}  # when a token was told last, by agent and key

    def put(self, kind: int, key: Any, payload: Any, encoding: Any, attachment: Any) -> None:
        """A message of this program: for its own subscribers, too."""
        key = str(key_expression(str(key)))
        message = [kind, key, *_on_the_way(ZBytes(payload), encoding, attachment)]
        if key == COMMAND:
            values = json.loads(message[2])
            self.command(values.get("force", 0.0), values.get("pitch", 0.0), values.get("yaw", 0.0))
            return
        self._deliver(message)
        if not key.startswith(OWN):
            self.send(message)

    def hears_of_itself(self) -> bool:
        """Whether the program listens to where its vehicle is."""
        return any(intersects(each.key_expr, NAVIGATION) for each in self.subscribers)

    def tell(self, navigation: bytes) -> None:
        """Tell it where its vehicle is."""
        self._deliver([PUT, NAVIGATION, navigation, "application/json", None])

    def hear(self, src: int, message: list[Any]) -> None:
        """A message of another agent has come."""
        kind = message[0]
        if kind in (PUT, DELETE):
            self._deliver(message)
        elif kind == QUERY:
            self._answer(src, message)
        elif kind == REPLY:
            _, to, number, key, data, encoding, attachment, failed = message
            if to == self.number and number in self.queries:
                sample = Sample(key, data, SampleKind.PUT, encoding, attachment)
                self.queries[number].take(Reply(None, ReplyError(data, encoding)) if failed else Reply(sample))
        elif kind == FINAL:
            _, to, number = message
            if to == self.number and number in self.queries:
                self.queries[number].answered(src)
        elif kind in (TOKEN, UNTOKEN):
            key = message[1]
            if kind == TOKEN:
                self._seen_ns[src, key] = self.turns.now_ns
            else:
                self._seen_ns.pop((src, key), None)
            for watcher in self.watchers:
                watcher.hear(src, key, alive=kind == TOKEN)

    def expire(self) -> None:
        """Let the tokens go whose programs have not told them for a lease: they died, or cannot be heard."""
        for src, key in [each for each, at_ns in self._seen_ns.items() if self.turns.now_ns - at_ns > LEASE_NS]:
            if src != self.number:
                self.hear(src, [UNTOKEN, key])

    def _deliver(self, message: list[Any]) -> None:
        kind, key, data, encoding, attachment = message
        for each in [*self.subscribers]:
            if intersects(each.key_expr, key):
                what = SampleKind.PUT if kind == PUT else SampleKind.DELETE
                each.take(Sample(key, data, what, encoding, attachment))

    def _answer(self, src: int, message: list[Any]) -> None:
        _, number, selector, payload, encoding, attachment = message
        found = [each for each in self.queryables if intersects(each.key_expr, selector.partition("?")[0])]
        left = len(found)

        def done() -> None:
            nonlocal left
            left -= 1
            if left <= 0:
                self.reply(src, [FINAL, src, number])

        for each in found:
            each.take(Query(self, src, number, selector, payload, encoding, attachment, done))
        if not found:
            done()

    def reply(self, to: int, message: list[Any]) -> None:
        """Send a reply or the end of the replies; to this program itself it comes at once."""
        if to == self.number:
            self.hear(self.number, message)
        else:
            self.send(message)

    def handler(self, handler: Any, default: int = 256) -> tuple[Callable[[Any], None], Any, Callable[[], None]]:
        """How a declaration hands over what comes: what takes it, the channel or None, and what ends it."""
        if handler is None:
            handler = FifoChannel(default)
        if isinstance(handler, FifoChannel):
            channel = Channel(self.turns, handler.capacity, ring=handler.ring)
            return channel.put, channel, channel.close
        if isinstance(handler, tuple):
            call, drop = handler[0], None
        else:
            call, drop = (handler.call, handler.drop) if isinstance(handler, Callback) else (handler, None)
        return lambda item: self.turns.call(call, item), None, drop or (lambda: None)


class Declared:
    """Something that can be undeclared, as at the end of a `with`."""

    def undeclare(self) -> None:
        """End it."""

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.undeclare()


class Declaration(Declared):
    """Something that hands over what comes."""

    def __init__(self, zenoh: Zenoh, key: Any, handler: Any, among: list[Any]) -> None:
        self.key_expr: KeyExpression = key_expression(str(key))
        self._among = among
        self.take, self.handler, self._end = zenoh.handler(handler)
        among.append(self)

    def undeclare(self) -> None:
        """End it."""
        if self in self._among:
            self._among.remove(self)
            self._end()

    def recv(self) -> Any:
        """The next that has come; waits for it."""
        return self.handler.recv()

    def try_recv(self) -> Any:
        """The next that has come; None: there is none."""
        return self.handler.try_recv()

    def __iter__(self) -> Iterator[Any]:
        return iter(self.handler)


class Subscriber(Declaration):
    """Hears samples."""


class Queryable(Declaration):
    """Answers queries."""


class Watcher(Declaration):
    """Hears of tokens that come and go."""

    def __init__(self, zenoh: Zenoh, key: Any, handler: Any) -> None:
        super().__init__(zenoh, key, handler, zenoh.watchers)
        self._alive: set[tuple[int, str]] = set()

    def hear(self, src: int, key: str, *, alive: bool) -> None:
        """A token is there, or is gone."""
        if intersects(self.key_expr, key) and ((src, key) in self._alive) != alive:
            (self._alive.add if alive else self._alive.discard)((src, key))
            self.take(Sample(key, b"", SampleKind.PUT if alive else SampleKind.DELETE, "zenoh/bytes", None))


class Token(Declared):
    """A token of liveliness, told again and again, since the water may lose it."""

    def __init__(self, zenoh: Zenoh, key: str) -> None:
        self._zenoh, self.key = zenoh, key
        zenoh.tokens.append(self)
        zenoh.hear(zenoh.number, [TOKEN, key])
        zenoh.send([TOKEN, key])

    def undeclare(self) -> None:
        """It is gone."""
        if self in self._zenoh.tokens:
            self._zenoh.tokens.remove(self)
            self._zenoh.hear(self._zenoh.number, [UNTOKEN, self.key])
            self._zenoh.send([UNTOKEN, self.key])


class Query:
    """A question that has come."""

    def __init__(
        self, zenoh: Zenoh, src: int, number: int, selector: str, payload: bytes | None, encoding: str,
        attachment: bytes | None, done: Callable[[], None],
    ) -> None:  # fmt: skip
        self._zenoh, self._src, self._number, self._done = zenoh, src, number, done
        key, _, self.parameters = selector.partition("?")
        self.key_expr, self.selector = key_expression(key), selector
        self.payload = None if payload is None else ZBytes(payload)
        self.encoding = Encoding(encoding)
        self.attachment = None if attachment is None else ZBytes(attachment)
        self._over = False

    def reply(self, key: Any, payload: Any, *, encoding: Any = None, attachment: Any = None, **_: Any) -> None:
        """Answer with a sample."""
        self._send(str(key), payload, encoding, attachment, failed=False)

    def reply_err(self, payload: Any, *, encoding: Any = None) -> None:
        """Answer with an error."""
        self._send("error", payload, encoding, None, failed=True)

    def _send(self, key: str, payload: Any, encoding: Any, attachment: Any, *, failed: bool) -> None:
        about = [key, *_on_the_way(ZBytes(payload), encoding, attachment), failed]
        self._zenoh.reply(self._src, [REPLY, self._src, self._number, *about])

    def drop(self) -> None:
        """No more replies come."""
        if not self._over:
            self._over = True
            self._done()

    def __enter__(self) -> Query:
        return self

    def __exit__(self, *_: object) -> None:
        self.drop()

    def __del__(self) -> None:
        if not self._zenoh.turns.over:
            self.drop()


class PendingQuery:
    """A question of this program, until all that it hears have answered, or its time is over."""

    def __init__(self, zenoh: Zenoh, number: int, handler: Any, timeout_s: float) -> None:
        self._zenoh, self._number, self._left = zenoh, number, {*zenoh.hears, zenoh.number}
        self.take, self.channel, self._end = zenoh.handler(handler)
        zenoh.queries[number] = self
        zenoh.turns.start(lambda: self._expire(zenoh.turns.now_ns + round(timeout_s * NS)))

    def _expire(self, at_ns: int) -> None:
        self._zenoh.turns.wait(at_ns)
        self.close()

    def answered(self, src: int) -> None:
        """An agent has no more replies."""
        self._left.discard(src)
        if not self._left:
            self.close()

    def close(self) -> None:
        """No more replies are taken."""
        if self._zenoh.queries.pop(self._number, None) is not None:
            self._end()


class OneKey(Declared):
    """Something that speaks on one key."""

    def __init__(self, zenoh: Zenoh, key: Any, listening: Sequence[Declaration]) -> None:
        self._zenoh, self.key_expr, self._listening = zenoh, key_expression(str(key)), listening

    @property
    def matching_status(self) -> MatchingStatus:
        """Whether somebody listens: something of this program, or anybody.

        An agent knows the agents that it hears, and takes them for those that hear it. It is not told what they have
        declared.
        """
        own = any(intersects(each.key_expr, str(self.key_expr)) for each in self._listening)
        return MatchingStatus(own or bool(self._zenoh.hears))

    def declare_matching_listener(self, handler: Any = None) -> Declaration:
        """Tell at once if somebody listens; no change is ever seen."""
        made = Declaration(self._zenoh, self.key_expr, handler, [])
        if self.matching_status.matching:
            made.take(self.matching_status)
        return made


class Publisher(OneKey):
    """Puts on one key."""

    def __init__(self, zenoh: Zenoh, key: Any, encoding: Any) -> None:
        super().__init__(zenoh, key, zenoh.subscribers)
        self._encoding = encoding

    def put(self, payload: Any, *, encoding: Any = None, attachment: Any = None, **_: Any) -> None:
        """Send a sample."""
        self._zenoh.put(PUT, self.key_expr, payload, encoding or self._encoding, attachment)

    def delete(self, *, attachment: Any = None, **_: Any) -> None:
        """Say that the key has no value any more."""
        self._zenoh.put(DELETE, self.key_expr, b"", None, attachment)


def _on_the_way(payload: Any, encoding: Any, attachment: Any) -> tuple[bytes | None, str, bytes | None]:
    """Payload, encoding and attachment as a message has them."""
    data, more = (None if each is None else ZBytes(each).to_bytes() for each in (payload, attachment))
    return data, str(encoding or "zenoh/bytes"), more


class Querier(OneKey):
    """Asks on one key."""

    def __init__(self, zenoh: Zenoh, session: Session, key: Any, about: dict[str, Any]) -> None:
        super().__init__(zenoh, key, zenoh.queryables)
        self._session, self._about = session, about

    def get(self, handler: Any = None, *, parameters: str = "", **about: Any) -> Any:
        """Ask."""
        selector = f"{self.key_expr}?{parameters}" if parameters else str(self.key_expr)
        return self._session.get(selector, handler, **(self._about | about))


class Liveliness:
    """Tokens that say who is there."""

    def __init__(self, zenoh: Zenoh) -> None:
        self._zenoh = zenoh

    def declare_token(self, key: Any) -> Token:
        """Be there."""
        return Token(self._zenoh, str(key_expression(str(key))))

    def declare_subscriber(self, key: Any, handler: Any = None, *, history: bool = False) -> Watcher:
        """Hear of tokens. Those that are there already come as they are told again."""
        return Watcher(self._zenoh, key, handler)


class SessionInfo:
    """Who a session is."""

    def __init__(self, number: int) -> None:
        self._number = number

    def zid(self) -> str:
        """Its identity."""
        return f"{self._number:x}"


class Session:
    """A session of a program."""

    def __init__(self, zenoh: Zenoh) -> None:
        self._zenoh, self._declared = zenoh, list[Any]()
        self._closed = False
        self.info = SessionInfo(zenoh.number)

    def put(self, key: Any, payload: Any, *, encoding: Any = None, attachment: Any = None, **_: Any) -> None:
        """Send a sample."""
        self._zenoh.put(PUT, key, payload, encoding, attachment)

    def delete(self, key: Any, *, attachment: Any = None, **_: Any) -> None:
        """Say that a key has no value any more."""
        self._zenoh.put(DELETE, key, b"", None, attachment)

    def get(
        self, selector: Any, handler: Any = None, *, payload: Any = None, encoding: Any = None, attachment: Any = None,
        timeout: float | None = None, **_: Any,
    ) -> Any:  # fmt: skip
        """Ask all queryables that match, of this program and of the agents that it reaches.

        Replies end when all agents that it hears have answered, or after the timeout [s].
        """
        zenoh, number = self._zenoh, next(self._zenoh.numbers)
        asked = PendingQuery(zenoh, number, handler, QUERY_TIMEOUT_S if timeout is None else timeout)
        key, mark, more = str(selector).partition("?")
        about = _on_the_way(payload, encoding, attachment)
        message = [QUERY, number, f"{key_expression(key)}{mark}{more}", *about]
        zenoh.send(message)
        zenoh.hear(zenoh.number, message)
        return asked.channel

    def declare_publisher(self, key: Any, *, encoding: Any = None, **_: Any) -> Publisher:
        """A publisher of a key."""
        return Publisher(self._zenoh, key, encoding)

    def declare_subscriber(self, key: Any, handler: Any = None, **_: Any) -> Subscriber:
        """A subscriber; the handler is a function, a channel, or left out for a FIFO."""
        self._declared.append(made := Subscriber(self._zenoh, key, handler, self._zenoh.subscribers))
        return made

    def declare_queryable(self, key: Any, handler: Any = None, **_: Any) -> Queryable:
        """A queryable."""
        self._declared.append(made := Queryable(self._zenoh, key, handler, self._zenoh.queryables))
        return made

    def declare_querier(self, key: Any, **about: Any) -> Querier:
        """A querier of a key."""
        return Querier(self._zenoh, self, key, {key: value for key, value in about.items() if key == "timeout"})

    def declare_keyexpr(self, key: Any) -> KeyExpression:
        """The key itself."""
        return key_expression(str(key))

    def liveliness(self) -> Liveliness:
        """Its tokens."""
        return Liveliness(self._zenoh)

    def zid(self) -> str:
        """Its identity."""
        return self.info.zid()

    def is_closed(self) -> bool:
        """Whether it was closed."""
        return self._closed

    def close(self) -> None:
        """End all that it has declared."""
        self._closed = True
        for each in self._declared:
            each.undeclare()
        for token in [*self._zenoh.tokens]:
            token.undeclare()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def zenoh_module(zenoh: Zenoh) -> ModuleType:
    """The module `zenoh` of one program."""

    def __getattr__(name: str) -> Any:  # noqa: N807
        raise AttributeError(f"zenoh.{name} is not there in lockstep; fleet netem runs the program with zenoh itself")

    handlers = stand_in(
        ModuleType("zenoh.handlers"), FifoChannel=FifoChannel, RingChannel=RingChannel, Callback=Callback,
        DefaultHandler=FifoChannel,
    )  # fmt: skip
    kinds = (Session, Query, Queryable, Subscriber, Publisher, Querier, Liveliness)
    return stand_in(
        ModuleType("zenoh"), **zenoh_values.VALUES, **{kind.__name__: kind for kind in kinds},
        ZError=ZenohError, KeyExpr=key_expression, Selector=lambda key, parameters="": f"{key}?{parameters}",
        open=lambda config=None: Session(zenoh), try_init_log_from_env=lambda: None, handlers=handlers,
        init_log_from_env_or=lambda _: None, __getattr__=__getattr__,
    )  # fmt: skip
