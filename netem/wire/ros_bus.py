"""A zenoh session among nodes of ROS 2 that use rmw_zenoh: what it is made of, as plain bytes.

Its peers find each other by gossip, and a publisher with a cache needs timestamps; all else is as for `OpenBus`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import zenoh
import zenoh.ext

from netem.errors import BusError
from netem.wire.open_bus import OpenBus, OpenPublication
from netem.wire.session import OTHERS, UNIVERSAL, client_settings, listening, reason, session_of

# The variables of rmw_zenoh: a file of zenoh's settings, and single ones as "key=value;key=value".
SESSION_FILE, SETTINGS = "ZENOH_SESSION_CONFIG_URI", "ZENOH_CONFIG_OVERRIDE"
_ROS: dict[str, Any] = {"timestamping/enabled": True, "transport/unicast/qos/enabled": True}
_LEASE = {"transport/link/tx/lease": 10_000}  # as rmw_zenoh's


class RosSample(NamedTuple):
    """A message, a request or an answer."""

    key: str
    payload: bytes
    attachment: bytes | None


class RosBus(OpenBus):
    """One session; `join`, `be_router` or `as_configured` makes it."""

    @classmethod
    def join(cls, endpoint: str, *, timeout_ms: int = 5000) -> RosBus:
        """A client of a router such as rmw_zenohd. Raises BusError: there is none."""
        return cls._ros("client", endpoint, client_settings([endpoint], None, timeout_ms), "no router answers at")

    @classmethod
    def be_router(cls, endpoint: str) -> RosBus:
        """A router, as rmw_zenohd is one. Raises BusError: the endpoint is not valid, or in use."""
        settings = listening([endpoint]) | {"scouting/gossip/enabled": True}
        return cls._ros("router", endpoint, settings, "cannot listen on")

    @classmethod
    def as_configured(cls) -> RosBus | None:
        """A session as the environment says, in rmw_zenoh's variables; None: it says nothing. Raises BusError if the
        file, or a setting, is none of zenoh's, or nobody answers.
        """
        path, single = os.environ.get(SESSION_FILE), os.environ.get(SETTINGS)
        if not path and not single:
            return None
        try:
            config = zenoh.Config.from_file(path) if path else zenoh.Config()
            alone = {} if path else {"mode": "client", "listen/endpoints": [], "scouting/multicast/enabled": False}
            for key, value in alone.items():  # so that nothing listens beyond this host
                config.insert_json5(key, json.dumps(value))
            for entry in filter(None, (single or "").split(";")):
                key, _, value = entry.partition("=")
                config.insert_json5(key.strip(), value.strip())
            for key, value in _ROS.items():
                config.insert_json5(key, json.dumps(value))
            where = [json.loads(config.get_json(f"{way}/endpoints")) for way in ("connect", "listen")]
            return cls(session_of(config), ", ".join(map(str, filter(None, where))))
        except zenoh.ZError as error:
            named = f"{SESSION_FILE}={path}" if path else f"{SETTINGS}={single}"
            raise BusError(f"zenoh does not take {named:.200}: {reason(error)}") from None

    @classmethod
    def _ros(cls, mode: Literal["client", "router"], endpoint: str, settings: dict[str, Any], problem: str) -> RosBus:
        bus = cls._open(mode, endpoint, UNIVERSAL | OTHERS | _LEASE | _ROS | settings, problem)
        assert isinstance(bus, RosBus)
        return bus

    @property
    def id(self) -> str:
        return str(self._session.zid())

    def token(self, key: str) -> None:
        """Declare a liveliness token until the session closes. Raises BusError: the key is none."""
        try:
            self._held.append(self._session.liveliness().declare_token(key))
        except zenoh.ZError:
            raise BusError(f"zenoh takes no key {key!r}") from None

    def tokens(self, key: str, *, timeout_s: float = 2.0) -> list[str]:
        """The keys of all tokens that there are and that match."""
        replies = self._session.liveliness().get(key, timeout=timeout_s)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def watch_tokens(self, key: str, handler: Callable[[str, bool], None]) -> None:
        """Call `handler(key, there)` on a thread of zenoh once for each liveliness token of a key expression that
        exists now, with True for each new one, and with False for each that ends.
        """

        def receive(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._held.append(self._session.liveliness().declare_subscriber(key, receive, history=True))

    def latched_publisher(self, key: str) -> Callable[[bytes, bytes], None]:
        """A publisher that puts payload and attachment on a key, and keeps the last for subscribers that come later."""
        publisher = zenoh.ext.declare_advanced_publisher(
            self._session, key, cache=zenoh.ext.CacheConfig(1), publisher_detection=True
        )
        self._held.append(publisher)

        def put(payload: bytes, attachment: bytes) -> None:
            publisher.put(payload, attachment=attachment)

        return put

    def plain(self, key: str, *, drop: bool) -> OpenPublication:
        """Puts on a key; `drop` as for `publication`. Raises BusError: the key is none."""
        return self.publication(key, "zenoh/bytes", drop=drop)

    def hear(self, key: str, handler: Callable[[RosSample], None]) -> Callable[[], None]:
        """Call `handler` on a thread of zenoh for every put of others. Returns what ends it."""

        def receive(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            handler(
                RosSample(
                    str(sample.key_expr),
                    sample.payload.to_bytes(),
                    None if attachment is None else attachment.to_bytes(),
                )
            )

        return self.subscribe(key, receive)

    def subscribe_with_history(self, key: str, handler: Callable[[Any], None]) -> Callable[[], None]:
        """As `subscribe`, and also what publishers keep for subscribers that come late. Raises BusError."""
        try:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            subscriber = zenoh.ext.declare_advanced_subscriber(self._session, key, handler, history=history)
        except zenoh.ZError:
            raise BusError(f"{key!r} is no key expression of zenoh: parts such as uuv_1/*, none empty") from None
        self._held.append(subscriber)
        return lambda: self._held.remove(subscriber)

    def serve(self, key: str, handler: Callable[[RosSample], tuple[bytes, bytes] | None]) -> None:
        """Answer calls of a service: `handler` gets a request, and returns payload and attachment, or None."""

        def receive(query: zenoh.Query) -> None:
            with query:
                payload, attachment = query.payload, query.attachment
                answer = handler(
                    RosSample(
                        key,
                        b"" if payload is None else payload.to_bytes(),
                        None if attachment is None else attachment.to_bytes(),
                    )
                )
                if answer is not None:
                    query.reply(key, answer[0], attachment=answer[1])

        self._held.append(self._session.declare_queryable(key, receive, complete=True))

    def call(self, key: str, payload: bytes, attachment: bytes, *, timeout_s: float = 10.0) -> bytes | None:
        """The answer of a service; None: there is none, or not in that time."""
        replies = self._session.get(
            key,
            payload=payload,
            attachment=attachment,
            timeout=timeout_s,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        return next((reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None), None)
