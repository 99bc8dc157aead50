"""The functions of zenoh that the processes of a run use: sessions, puts, subscriptions, queries, tokens.

`netem.wire.session` documents the settings. Keys are zenoh key expressions. Handlers run on a thread of zenoh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any

import zenoh

from netem.errors import BusError
from netem.limits import WIRE_MESSAGE
from netem.wire.credentials import LEASE_MS, Credentials, Listener, Members, access_control
from netem.wire.keys import Keys
from netem.wire.linger import never_linger
from netem.wire.parts import PART_BYTES, pieces
from netem.wire.queues import PutQueue, Stamped
from netem.wire.session import (
    client_settings,
    client_tls,
    listening,
    open_session,
    reason,
    router_settings,
    server_tls,
    users_file,
)

CLOSE_S = 3.0
Handler = Callable[[str, bytes], None]
Respond = Callable[[bytes], None]
QueryHandler = Callable[[str, bytes, Respond], None]


class Bus:
    """One open zenoh session. Create it with `connect` or `host`, and call `close` at the end."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self._session = session
        self._held: list[Any] = []
        self.endpoint = endpoint
        # With a full channel, closing would block forever; so it has its own thread, and `close` stops waiting. The
        # thread is there from the beginning: at the end the system may have none left, and an open session would keep
        # the process from ending.
        self._over = Event()
        self._closing = Thread(target=self._close_when_over, name="bus-close", daemon=True)
        try:
            self._closing.start()
        except RuntimeError:
            session.close()  # type: ignore[no-untyped-call]  # which has no channel yet
            raise

    @classmethod
    def connect(
        cls, endpoint: str, credentials: Credentials, *, timeout_ms: int = 5000, puts: Sequence[str] = ()
    ) -> Bus:
        """A client session to a run's router, or to the first of several addresses, separated by commas, that answers.
        Raises BusError if none answers in time, or it refuses the credentials or the certificate.

        All publishers on keys of one expression in `puts` are declared to the router as one. Without this, a thousand
        declarations at once block zenoh: the thread that waits for room in the socket is the one that would make room.
        """
        settings = {
            **client_settings(endpoint.split(","), credentials, timeout_ms),
            "transport/link/tx/lease": credentials.lease_ms,
            "aggregation/publishers": [*puts],
            **client_tls(credentials),
        }
        try:
            return cls(open_session("client", settings), endpoint)
        except zenoh.ZError as error:
            tls = ", its certificate is not of the CA that we trust" if "tls/" in endpoint else ""
            raise BusError(
                f"cannot join the run at {endpoint} as {credentials.user}: nobody listens there{tls}, "
                f"or the credentials are of another run ({reason(error)})"
            ) from None

    @classmethod
    def host(
        cls,
        endpoint: str,
        keys: Keys,
        vehicles: tuple[int, ...],
        credentials: dict[str, Credentials],
        private: Path,
        listener: Listener | None = None,
        hosts: Members = (),
    ) -> Bus:
        """Open the router of a run: it listens on `endpoint`, checks users (`credentials`, by role) and enforces the
        access-control list. `private` is a directory of mode 0700: zenoh reads the users from a file there, which is
        removed as soon as the session is open. `listener` has additional endpoints, for processes that do not belong to
        the run; `hosts` are the agents that share processes. Raises BusError if an endpoint is already in use, or this
        process may not listen on it; OSError if the file of users cannot be written.
        """
        users = users_file(private, credentials.values())
        endpoints = [endpoint, *(listener.endpoints if listener else ())]
        certified = {role: [role] for role in listener.certified} if listener else {}
        control = access_control(keys, vehicles, hosts=hosts, certified=certified)
        settings = {
            **router_settings(len(vehicles), listener.lease_ms if listener else LEASE_MS),
            **listening(endpoints),
            "transport/auth/usrpwd/dictionary_file": str(users),
            "access_control": control,
            **({} if listener is None else server_tls(listener, mutual=bool(listener.certified))),
        }
        try:
            bus = cls(open_session("router", settings), endpoint)
        except zenoh.ZError as error:
            raise BusError(f"cannot listen on {' and '.join(endpoints)}: {reason(error)}") from None
        finally:
            users.unlink(missing_ok=True)
        if listener is not None:
            bus.watch_begins(lambda _: never_linger())
        return bus

    def on_lost(self, handler: Callable[[], None]) -> None:
        """Call `handler()` on a zenoh thread when a link to the router, or to a client of this router, has ended. A
        client's session connects again by itself; messages that were in transit are lost without an error.
        """

        self.watch_ends(lambda _: handler())

    def tokens(self, key: str, *, timeout_s: float = 2.0) -> list[str]:
        """The keys of all liveliness tokens that exist now and match `key`, sorted."""
        replies = self._session.liveliness().get(key, timeout=timeout_s)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def publisher(self, key: str) -> Callable[[bytes], None]:
        """A function that puts bytes on `key`, reliably and in order. It blocks while the link is congested, and raises
        BusError for more than WIRE_MESSAGE.bytes bytes, or when the link to the router has ended.
        """
        publisher = self._session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
            express=True,
        )
        self._held.append(publisher)

        def put(data: bytes) -> None:
            if len(data) > WIRE_MESSAGE.bytes:
                raise BusError(f"a message of {len(data)} bytes on {key}: the transport carries {WIRE_MESSAGE.bytes}")
            try:
                publisher.put(data)
            except zenoh.ZError as error:
                raise BusError(f"cannot put on {key}: {reason(error)}") from None

        return put

    def subscribe(self, key: str, handler: Handler, *, of_others: bool = False) -> None:
        """Call `handler(key, bytes)` on a zenoh thread for every put; it must be short: only put them into a queue.

        With `of_others`, puts of this session do not count.
        """

        def receive(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.payload.to_bytes())

        origin = zenoh.Locality.REMOTE if of_others else zenoh.Locality.ANY
        self._held.append(self._session.declare_subscriber(key, receive, allowed_origin=origin))

    def channel(self, key: str, capacity: int = 4096) -> PutQueue:
        """A queue of every put on a key or key expression, filled by zenoh without a Python callback.

        A callback needs the interpreter lock and so interrupts the main thread. In the main loops of world and agents
        it would take a fifth of the CPU time. If the channel is full, the senders block, and this session receives
        nothing else. So a thread that waits on one channel must not leave another one full. `capacity` should be small
        if foreign programs can put: each put in the queue may hold 0.5 MB (measured: zenoh keeps the whole buffer that
        it received).
        """
        return PutQueue(self._session.declare_subscriber(key, zenoh.handlers.FifoChannel(capacity)))

    def stamped_queue(self, key: str) -> Stamped:
        """A queue of every put on `key` with its time of arrival [ns, CLOCK_MONOTONIC]; each put costs a callback."""
        stamped = Stamped()
        self.subscribe(key, stamped.put)
        return stamped

    def answer(self, key: str, handler: QueryHandler) -> None:
        """Call `handler(key, request, respond)` on a zenoh thread for every query on `key`.

        Call `respond(answer)` exactly once; later and from another thread is allowed.
        """

        def receive(query: zenoh.Query) -> None:
            key_expr = query.key_expr
            request = b"" if query.payload is None else query.payload.to_bytes()

            def respond(answer: bytes) -> None:
                # The transport cannot carry a long message: a long answer is sent in several replies.
                for piece in pieces(answer, PART_BYTES) or [b""]:
                    query.reply(key_expr, piece)
                query.drop()  # type: ignore[no-untyped-call]

            handler(str(key_expr), request, respond)

        self._held.append(self._session.declare_queryable(key, receive))

    def ask(self, key: str, request: bytes = b"", *, timeout_s: float = 2.0) -> bytes | None:
        """The answer to a query on `key`, all replies joined; None: no complete answer within `timeout_s` [s]."""
        parts = []
        every = zenoh.ConsolidationMode.NONE  # in other modes zenoh keeps only one reply of each key
        for reply in self._session.get(key, payload=request, timeout=timeout_s, consolidation=every):
            if reply.ok is None:
                return None
            parts.append(reply.ok.payload.to_bytes())
        return b"".join(parts) if parts else None

    def token(self, key: str) -> Callable[[], None]:
        """Declare a liveliness token on `key`: it exists until the function that is returned is called, or the session
        closes."""
        token = self._session.liveliness().declare_token(key)
        self._held.append(token)

        def withdraw() -> None:
            if token not in self._held:  # the session is closed, and with it the token
                return
            self._held.remove(token)
            token.undeclare()  # type: ignore[no-untyped-call]

        return withdraw

    def watch_tokens(self, key: str, handler: Callable[[str, bool], None]) -> None:
        """Call `handler(key, alive)` on a zenoh thread when a token appears or disappears, and for each that exists."""

        def receive(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._held.append(self._session.liveliness().declare_subscriber(key, receive, history=True))

    def watch_begins(self, handler: Callable[[str], None]) -> None:
        """Call `handler(zenoh id)` on a zenoh thread when a link to another session begins."""
        self._watch(zenoh.SampleKind.PUT, handler)

    def watch_ends(self, handler: Callable[[str], None]) -> None:
        """Call `handler(zenoh id)` on a zenoh thread when the link to another session has ended."""
        self._watch(zenoh.SampleKind.DELETE, handler)

    def _watch(self, kind: zenoh.SampleKind, handler: Callable[[str], None]) -> None:
        """Call `handler(zenoh id)` on a zenoh thread when a link to another session begins (PUT) or ends (DELETE)."""

        def receive(event: zenoh.TransportEvent) -> None:
            if event.kind == kind:
                handler(str(event.transport.zid))

        # Without history: zenoh 1.10 panics when it lists transports that are `lowlatency`.
        self._held.append(self._session.info.declare_transport_events_listener(receive, history=False))

    def keep(self, what: object) -> None:
        """Hold `what` until the session closes."""
        self._held.append(what)

    def close(self) -> None:
        """Close the session with all its publishers, subscribers and tokens. Waits for at most CLOSE_S = 3 s."""
        self._held.clear()
        self._over.set()
        self._closing.join(CLOSE_S)

    def _close_when_over(self) -> None:
        self._over.wait()
        self._session.close()  # type: ignore[no-untyped-call]
