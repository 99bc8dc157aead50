"""A zenoh session for traffic of others: any key, encoding and attachment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import zenoh

from netem.errors import BusError
from netem.wire.credentials import Credentials, observer_control
from netem.wire.keys import Keys
from netem.wire.session import OTHERS, UNIVERSAL, client_settings, listening, open_session, reason, users_file


class ZenohSample(NamedTuple):
    """A put or a delete of another program, with everything that zenoh delivers with it."""

    key: str
    payload: bytes
    delete: bool
    encoding: str  # zenoh's, `type/subtype[;schema]`
    attachment: bytes | None
    stamp_ns: int | None  # zenoh's timestamp, ns since 1970, if the sample has one


class OpenPublication:
    """Puts on one key with one encoding."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher

    @property
    def matched(self) -> bool:
        status: Any = self._publisher.matching_status  # the stub says bool, and the object is always true
        return bool(getattr(status, "matching", status))

    def put(self, payload: bytes, attachment: bytes | None, place: int | None = None) -> None:
        """Put a sample, with data beside the payload or None. `place` is the number of earlier puts on the key, those
        that were left out included, so that a reader notices them.
        """
        source = None if place is None else zenoh.SourceInfo(self._publisher.id, place)
        self._publisher.put(payload, attachment=attachment, source_info=source)

    def delete(self, attachment: bytes | None) -> None:
        self._publisher.delete(attachment=attachment)


class OpenBus:
    """A session for the traffic of others: journals that are published or played, and traffic that is recorded.

    Unlike `Bus` it speaks zenoh's universal transport. That fragments long messages, sends from a task of its own, and
    can drop messages for a reader that is too slow. With `lowlatency` such a reader would delay the sender.
    """

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self._session = session
        self._held: list[Any] = []
        self.endpoint = endpoint

    @classmethod
    def listen(cls, endpoint: str) -> OpenBus:
        """Open a router without credentials. Every process that reaches the endpoint may join. Raises BusError if the
        endpoint is not valid, or it is in use.
        """
        return cls._listen(endpoint, OTHERS)

    @classmethod
    def host(cls, endpoint: str, keys: Keys, observer: Credentials, private: Path) -> OpenBus:
        """A router where the observer may read the journal of a run; everything else is refused. `private`: a directory
        of mode 0700, as for `Bus.host`. Raises BusError if the endpoint is taken or none.
        """
        users = users_file(private, [observer])
        settings = {
            "transport/auth/usrpwd/dictionary_file": str(users),
            "access_control": observer_control(keys),
            # More is queued before anything is dropped; 16 is zenoh's most.
            "transport/link/tx/queue/size/data": 16,
        }
        try:
            return cls._listen(endpoint, settings)
        finally:
            users.unlink(missing_ok=True)

    @classmethod
    def _listen(cls, endpoint: str, settings: dict[str, Any]) -> OpenBus:
        return cls._open("router", endpoint, listening([endpoint]) | settings, "cannot listen on")

    @classmethod
    def connect(cls, endpoint: str, credentials: Credentials | None = None, *, timeout_ms: int = 5000) -> OpenBus:
        """A client of a router or peer. Raises BusError: there is no router, or it refuses the credentials."""
        settings = client_settings([endpoint], credentials, timeout_ms) | OTHERS
        return cls._open("client", endpoint, settings, "nobody answers, or lets us in, at")

    @classmethod
    def _open(cls, mode: Literal["client", "router"], endpoint: str, settings: dict[str, Any], problem: str) -> OpenBus:
        universal = UNIVERSAL | {"transport/unicast/qos/enabled": True, "transport/link/tx/lease": 10_000}
        try:
            return cls(open_session(mode, universal | settings), endpoint)
        except zenoh.ZError as error:
            raise BusError(f"{problem} {endpoint} ({reason(error)})") from None

    def publication(self, key: str, encoding: str, *, drop: bool) -> OpenPublication:
        """Puts on `key`, in order. With `drop`, what a slow subscriber has no room for is lost to it; otherwise the put
        waits, and zenoh closes the link to a subscriber that takes nothing for 5 s. Raises BusError if the key is none.
        """
        control = zenoh.CongestionControl.DROP if drop else zenoh.CongestionControl.BLOCK
        try:
            publisher = self._session.declare_publisher(
                key, encoding=encoding, congestion_control=control, reliability=zenoh.Reliability.RELIABLE
            )
        except zenoh.ZError:
            raise BusError(f"zenoh cannot publish on {key!r}: expected a key such as robot/1/odom") from None
        self._held.append(publisher)
        return OpenPublication(publisher)

    def subscribe(self, key: str, handler: Callable[[Any], None]) -> Callable[[], None]:
        """Call `handler` with zenoh's own sample, on a thread of zenoh; `sample_of` reads it later. Returns a function
        that ends the subscription. Raises BusError if the key expression is none.
        """
        try:
            subscriber = self._session.declare_subscriber(key, handler)
        except zenoh.ZError:
            what = "is no key expression of zenoh: parts such as robot/*/odom or robot/**, none of them empty"
            raise BusError(f"{key!r} {what}") from None
        self._held.append(subscriber)

        def end() -> None:
            self._held.remove(subscriber)
            subscriber.undeclare()  # type: ignore[no-untyped-call]

        return end

    def ask(self, key: str, *, timeout_s: float = 2.0) -> dict[str, bytes]:
        """The answers to a query on `key`, which may have wildcards, by their own keys; none after `timeout_s` [s]."""
        replies = [reply.ok for reply in self._session.get(key, timeout=timeout_s)]
        return {str(sample.key_expr): sample.payload.to_bytes() for sample in replies if sample is not None}

    def answer(self, key: str, answers: dict[str, bytes]) -> None:
        """Answer queries on `key` with those of the values whose key they ask for."""

        def receive(query: zenoh.Query) -> None:
            with query:
                for name, data in answers.items():
                    if query.key_expr.intersects(name):
                        query.reply(name, data)

        self._held.append(self._session.declare_queryable(key, receive))

    @property
    def connected(self) -> bool:
        """Whether there is a router or peer on the other side; of a client, whether it still reaches its router."""
        info = self._session.info
        return bool(info.routers_zid() or info.peers_zid())

    def close(self) -> None:
        """Send what is queued and close the session."""
        self._held.clear()
        self._session.close()  # type: ignore[no-untyped-call]


def place_of(received: Any) -> int | None:
    """How many samples were put on the key before this one; None: its publisher does not say."""
    source = received.source_info
    return None if source is None else int(source.source_sn)


def sample_of(received: Any) -> ZenohSample:
    attachment, stamp = received.attachment, received.timestamp
    return ZenohSample(
        str(received.key_expr),
        received.payload.to_bytes(),
        received.kind == zenoh.SampleKind.DELETE,
        str(received.encoding),
        None if attachment is None else attachment.to_bytes(),
        None if stamp is None else stamp.get_time_as_ntp64().as_nanos(),
    )
