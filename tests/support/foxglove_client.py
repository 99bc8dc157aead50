"""A viewer: a client of Foxglove's websocket (foxglove.sdk.v1), written after its description and not with its SDK."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from struct import Struct
from time import monotonic
from typing import Any, NamedTuple

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

LIMIT_S = 60.0  # for a machine that does other things at the same time
_DATA, _CALL, _PLAY = Struct("<IQ"), Struct("<III"), Struct("<BBfBQI")
_STATE = Struct("<BQfBI")


class Received(NamedTuple):
    """A message of a topic."""

    topic: str
    log_ns: int
    data: bytes


class PlaybackTold(NamedTuple):
    """How a log is played."""

    status: str
    at_ns: int
    rate: float
    jumped: bool
    request: str


class Viewer:
    """A connection, and everything that came over it so far."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.infos: list[dict[str, Any]] = []
        self.messages: list[Received] = []
        self.times: list[int] = []
        self.states: list[PlaybackTold] = []
        self.told: list[str] = []
        self._answers: dict[int, Any] = {}
        self._topics: dict[int, str] = {}

    def until(self, what: Callable[[], Any]) -> Any:
        """The first true value of `what`, asked after each message that comes."""
        deadline = monotonic() + LIMIT_S
        while not (value := what()):
            assert monotonic() < deadline, f"it did not come within {LIMIT_S:g} s"
            with suppress(TimeoutError):
                self._take(self._connection.recv(timeout=0.1))
        return value

    def until_closed(self) -> None:
        """Take all messages until the server closes the connection."""
        with suppress(ConnectionClosed):
            self.until(lambda: False)

    def _take(self, received: str | bytes) -> None:
        if isinstance(received, str):
            self._json(json.loads(received))
        else:
            self._binary(received[0], received[1:])

    def subscribe(self, *topics: str) -> None:
        new = {len(self._topics) + n: topic for n, topic in enumerate(topics)}
        self._topics |= new
        self._send(
            op="subscribe", subscriptions=[{"id": n, "channelId": self.channels[t]["id"]} for n, t in new.items()]
        )

    def unsubscribe(self, *topics: str) -> None:
        self._send(op="unsubscribe", subscriptionIds=[n for n, topic in self._topics.items() if topic in topics])

    def call(self, service: str, body: str | None = None, **asked: Any) -> Any:
        """The answer of a service: an object, or the words of its refusal.

        Args:
            body: the request, in place of an object with `asked`.
        """
        number = len(self._answers) + 1
        head = _CALL.pack(self.services[service]["id"], number, len(b"json"))
        self._connection.send(b"\x02" + head + b"json" + (json.dumps(asked) if body is None else body).encode())
        return self.until(lambda: self._answers.get(number))

    def control(self, *, play: bool, rate: float = 1.0, seek_ns: int | None = None, request: str = "r") -> PlaybackTold:
        """Ask for how the log is to be played; the answer."""
        name = request.encode()
        head = _PLAY.pack(3, 0 if play else 1, rate, seek_ns is not None, seek_ns or 0, len(name))
        self._connection.send(head + name)
        found: PlaybackTold = self.until(lambda: next((s for s in self.states if s.request == request), None))
        return found

    def of(self, topic: str) -> list[Received]:
        """What came on a topic."""
        return [message for message in self.messages if message.topic == topic]

    def _send(self, **values: Any) -> None:
        self._connection.send(json.dumps(values))

    def _json(self, values: dict[str, Any]) -> None:
        match values["op"]:
            case "serverInfo":
                self.infos.append(values)
            case "advertise":
                self.channels |= {channel["topic"]: channel for channel in values["channels"]}
            case "advertiseServices":
                self.services |= {service["name"]: service for service in values["services"]}
            case "status":
                self.told.append(values["message"])
            case "serviceCallFailure":
                self._answers[values["callId"]] = values["message"]

    def _binary(self, opcode: int, data: bytes) -> None:
        match opcode:
            case 1:
                number, log_ns = _DATA.unpack_from(data)
                self.messages.append(Received(self._topics[number], log_ns, data[_DATA.size :]))
            case 2:
                self.times.append(int.from_bytes(data, "little"))
            case 3:
                _, number, length = _CALL.unpack_from(data)
                self._answers[number] = json.loads(data[_CALL.size + length :])
            case 5:
                status, at_ns, rate, jumped, _ = _STATE.unpack_from(data)
                words = ("playing", "paused", "buffering", "ended")[status]
                self.states.append(PlaybackTold(words, at_ns, rate, bool(jumped), data[_STATE.size :].decode()))


@contextmanager
def viewer(endpoint: str, most: int | None = None) -> Iterator[Viewer]:
    """A viewer that knows which topics there are.

    Args:
        most: how many messages it takes from the socket before the test reads them; None: all.
    """
    with connect(
        endpoint, subprotocols=[Subprotocol("foxglove.sdk.v1")], compression=None, max_queue=most, ping_interval=None
    ) as connection:
        found = Viewer(connection)
        found.until(lambda: found.channels)
        yield found
