"""Zenoh as the processes of a run use it: sessions, puts, subscriptions, queries, tokens.

`netem.wire.settings` has the settings and the reasons for them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

import zenoh

from netem.errors import BusError
from netem.wire.access import LEASE_MS, Credentials, Listener, access_control
from netem.wire.keys import Keys
from netem.wire.linger import never_linger
from netem.wire.parts import PART_BYTES, pieces
from netem.wire.queues import Channel, Stamped
from netem.wire.session import open_session, reason, users_file
from netem.wire.settings import MAX_BYTES, client_settings, client_tls, listening, router_settings, server_tls

CLOSE_S = 3.0
Handler = Callable[[str, bytes], None]
Respond = Callable[[bytes], None]
QueryHandler = Callable[[str, bytes, Respond], None]


class Bus:
    """One open zenoh session. Use `connect` or `host`; close it when done."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self._session = session
        self._held: list[Any] = []
        self.endpoint = endpoint

    @classmethod
    def connect(cls, endpoint: str, credentials: Credentials, *, timeout_ms: int = 5000) -> Bus:
        """A client session to a run's router.

        Args:
            endpoint: several, with commas between them, are tried in turn.

        Raises:
            BusError: there is no router, or it refuses the credentials.
        """
        settings = {
            **client_settings(endpoint.split(","), credentials, timeout_ms),
            "transport/link/tx/lease": credentials.lease_ms,
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
    ) -> Bus:
        """The run's router: listens on `endpoint`, checks the users and enforces the access-control list.

        Args:
            private: a directory of mode 0700; zenoh reads the users from a file there, which is removed
                as soon as the session is open.
            listener: where it listens for others than the run's own processes, too.

        Raises:
            BusError: the endpoint is taken or not ours to listen on.
        """
        users = users_file(private, credentials.values())
        endpoints = [endpoint, *(listener.endpoints if listener else ())]
        certified = {role: [role] for role in listener.certified} if listener else {}
        control = access_control(keys, vehicles, certified=certified)
        settings = {
            **router_settings(len(vehicles), listener.lease_ms if listener else LEASE_MS),
            **listening(endpoints),
            "transport/auth/usrpwd/dictionary_file": str(users),
            "access_control": control,
            **({} if listener is None else server_tls(listener)),
        }
        try:
            bus = cls(open_session("router", settings), endpoint)
        except zenoh.ZError as error:
            raise BusError(f"cannot listen on {' and '.join(endpoints)}: {reason(error)}") from None
        finally:
            users.unlink(missing_ok=True)
        if listener is not None:
            bus._watch(zenoh.SampleKind.PUT, lambda _: never_linger())
        return bus

    def on_lost(self, handler: Callable[[], None]) -> None:
        """Call `handler()` on a zenoh thread when the link to the router, or to a client of this router, has ended.

        A client's session makes another link by itself; messages on the way are lost without an error.
        """

        self.watch_ends(lambda _: handler())

    def tokens(self, key: str, *, timeout_s: float = 2.0) -> list[str]:
        """The liveliness tokens there are now."""
        replies = self._session.liveliness().get(key, timeout=timeout_s)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def publisher(self, key: str) -> Callable[[bytes], None]:
        """A function that puts bytes on `key`, reliably and in order.

        The function raises BusError for more than MAX_BYTES bytes, or when the link to the router has ended.
        """
        publisher = self._session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
            express=True,
        )
        self._held.append(publisher)

        def put(data: bytes) -> None:
            if len(data) > MAX_BYTES:
                raise BusError(f"a message of {len(data)} bytes on {key}: the transport carries {MAX_BYTES}")
            try:
                publisher.put(data)
            except zenoh.ZError as error:
                raise BusError(f"cannot put on {key}: {reason(error)}") from None

        return put

    def subscribe(self, key: str, handler: Handler) -> None:
        """Call `handler(key, bytes)` on a zenoh thread for every put; hand over to a queue there."""

        def receive(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.payload.to_bytes())

        self._held.append(self._session.declare_subscriber(key, receive))

    def channel(self, key: str, capacity: int = 4096) -> Channel:
        """A queue of every put on `key`, filled by zenoh without a Python callback.

        A callback needs the interpreter lock, and so interrupts the main thread; for the
        hot path of world and agents this costs a fifth of their CPU time. When the channel is full, the
        senders' links wait, and so does everything else that comes in on the session: who takes from one channel only
        must not let another one fill. Where other programs may put, the capacity should be small: each put that waits
        may hold half a megabyte (measured: zenoh keeps the buffer that it came in).
        """
        return Channel(self._session.declare_subscriber(key, zenoh.handlers.FifoChannel(capacity)))

    def stamped(self, key: str) -> Stamped:
        """A queue of every put on `key` with the time at which it came in, at the cost of a Python callback each."""
        stamped = Stamped()
        self.subscribe(key, stamped.put)
        return stamped

    def answer(self, key: str, handler: QueryHandler) -> None:
        """Call `handler(key, request, respond)` on a zenoh thread for every query on `key`.

        `respond` may be called later and from another thread, once.
        """

        def receive(query: zenoh.Query) -> None:
            key_expr = query.key_expr
            request = b"" if query.payload is None else query.payload.to_bytes()

            def respond(answer: bytes) -> None:
                # The transport carries no long message: what is long goes in several replies.
                for piece in pieces(answer, PART_BYTES) or [b""]:
                    query.reply(key_expr, piece)
                query.drop()  # type: ignore[no-untyped-call]

            handler(str(key_expr), request, respond)

        self._held.append(self._session.declare_queryable(key, receive))

    def ask(self, key: str, request: bytes = b"", *, timeout_s: float = 2.0) -> bytes | None:
        """The answer to a query on `key`, its replies joined; None when no answer, or only a part, came in time."""
        parts = []
        every = zenoh.ConsolidationMode.NONE  # otherwise replies on one key replace each other
        for reply in self._session.get(key, payload=request, timeout=timeout_s, consolidation=every):
            if reply.ok is None:
                return None
            parts.append(reply.ok.payload.to_bytes())
        return b"".join(parts) if parts else None

    def token(self, key: str) -> None:
        """Hold a liveliness token until the session closes."""
        self._held.append(self._session.liveliness().declare_token(key))

    def watch_tokens(self, key: str, handler: Callable[[str, bool], None]) -> None:
        """Call `handler(key, alive)` when a token appears or disappears."""

        def receive(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._held.append(self._session.liveliness().declare_subscriber(key, receive, history=True))

    def watch_ends(self, handler: Callable[[str], None]) -> None:
        """Call `handler(zenoh id)` when a session of another process has ended."""
        self._watch(zenoh.SampleKind.DELETE, handler)

    def _watch(self, kind: zenoh.SampleKind, handler: Callable[[str], None]) -> None:
        """Call `handler(zenoh id)` when a session of another process has begun (PUT) or ended (DELETE)."""

        def receive(event: zenoh.TransportEvent) -> None:
            if event.kind == kind:
                handler(str(event.transport.zid))

        # Without history: zenoh 1.10 panics when it lists transports that are `lowlatency`.
        self._held.append(self._session.info.declare_transport_events_listener(receive, history=False))

    def close(self) -> None:
        """Close the session; everything declared through it is gone."""
        self._held.clear()
        # A session that still receives into a full channel would never close.
        closing = Thread(target=self._session.close, daemon=True)
        closing.start()
        closing.join(CLOSE_S)
