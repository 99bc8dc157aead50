"""Messages with their schemas on Foxglove's websocket, and what its clients ask for, as a queue of events.

The protocol is the business of foxglove-sdk, which answers clients on threads of its own. It keeps a queue for each
client, and drops the oldest messages when the client takes none: nobody here ever waits for a client.

Time stamps are simulated time, in ns from 0, as in the log; a viewer that shows dates shows 1970. The server's time is
sent along (capability `time`), because Lichtblick stamps what it receives with it.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

import foxglove
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    MessageSchema,
    PlaybackCommand,
    PlaybackControlRequest,
    PlaybackState,
    PlaybackStatus,
    ServerListener,
    Service,
    ServiceRequest,
    ServiceSchema,
    StatusLevel,
    WebSocketServer,
)

from fleet.errors import FleetError
from fleet.processes.limits import allow_most_open_files

TIME_NS = 16_000_000  # of wall time between two messages with the server's time
BACKLOG = 20_000  # messages that wait for a client: some ticks of a large fleet
PORT = 8765  # which viewers propose
FELL_BEHIND = "a viewer takes less than comes: what has waited longest is left out for it"

_DROPPING = "foxglove.websocket.connected_client.send_lossy"  # by this name the SDK logs that it drops messages


class FoxgloveChannel(NamedTuple):
    """A topic that clients may subscribe to."""

    topic: str
    encoding: str  # of its messages, in MCAP's words
    schema: str  # its name
    schema_encoding: str
    schema_data: bytes

    def make(self, context: foxglove.Context) -> foxglove.Channel:
        schema = None
        if self.schema:
            schema = foxglove.Schema(name=self.schema, encoding=self.schema_encoding, data=self.schema_data)
        return foxglove.Channel(self.topic, message_encoding=self.encoding, schema=schema, context=context)


class ServiceOffer(NamedTuple):
    """A service for clients: JSON objects in and out, with their JSON schemas."""

    name: str
    request: dict[str, Any]
    answer: dict[str, Any]
    call: Callable[[dict[str, Any]], dict[str, Any]]  # on a thread of the SDK's; the words of an error go to the client


class Subscription(NamedTuple):
    """A client wants the messages of a channel, or does not want them any more."""

    channel: int
    client: int
    wanted: bool


class PlaybackRequest(NamedTuple):
    """A client controls how a log is played."""

    play: bool
    rate: float
    seek_ns: int | None  # of log time; None: go on from where it is
    id: str


class FoxgloveServer:
    """A server for any number of clients; `close` ends it."""

    def __init__(
        self,
        name: str,
        host: str,
        port: int | None,
        channels: dict[int, FoxgloveChannel],
        *,
        services: Sequence[ServiceOffer] = (),
        range_ns: tuple[int, int] | None = None,
    ) -> None:
        """Listen. `port`: None: 8765, or another one if that is taken. `services`: what clients may ask for.
        `range_ns`: of the time that clients may seek in; None: they have no control of it. Raises FleetError: the port
        is taken, or the address is none of this host."""
        self._events: SimpleQueue[Subscription | PlaybackRequest] = SimpleQueue()
        self._wanted: set[tuple[int, int]] = set()  # channel and client
        self._told_ns = 0  # wall time
        self.sent = 0  # messages that somebody wanted
        self._context = context = foxglove.Context()  # the SDK itself does not hold it
        self._channels = {number: channel.make(context) for number, channel in channels.items()}
        numbers: dict[int, list[int]] = {}  # the SDK has one channel for those of one topic and schema
        for number, made in self._channels.items():
            numbers.setdefault(made.id(), []).append(number)
        self._drops = _Drops()
        allow_most_open_files()  # connections that never ask for anything take one each
        self._server = _start_server(
            host,
            [PORT, 0] if port is None else [port],
            name=name,
            capabilities=[Capability.Time, *([Capability.Services] if services else [])],
            server_listener=_Listener(self._events, numbers),
            supported_encodings=["json"],
            services=[_service(offer) for offer in services],
            context=context,
            playback_time_range=range_ns,
            message_backlog_size=BACKLOG,
        )
        self.endpoint = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"

    @property
    def viewers(self) -> int:
        return len({client for _, client in self._wanted})

    @property
    def wanted(self) -> set[int]:
        return {channel for channel, _ in self._wanted}

    def events(self, timeout_s: float) -> list[Subscription | PlaybackRequest]:
        """The requests of clients since the last call; waits for the first one up to a time."""
        found: list[Subscription | PlaybackRequest] = []
        with suppress(Empty):
            found.append(self._events.get(timeout=timeout_s) if timeout_s > 0 else self._events.get_nowait())
            while True:
                found.append(self._events.get_nowait())
        for event in found:
            if isinstance(event, Subscription):
                change = self._wanted.add if event.wanted else self._wanted.discard
                change((event.channel, event.client))
        return found

    def put(self, channel: int, data: bytes, log_ns: int) -> None:
        """Send a message to the clients that want it. From any thread."""
        to = self._channels[channel]
        if to.has_sinks():
            to.log(data, log_time=log_ns)
            self.sent += 1

    def time(self, log_ns: int, *, now: bool = False) -> None:
        """The present time, sent now and then, or at once."""
        wall = time.monotonic_ns()
        if now or wall - self._told_ns >= TIME_NS:
            self._told_ns = wall
            self._server.broadcast_time(log_ns)

    def state(self, status: str, log_ns: int, rate: float, *, jumped: bool = False, request: str = "") -> None:
        """How the log is played: `Playing`, `Paused` or `Ended`. `jumped`: the time did not just go on. `request`: the
        id of the request that this answers."""
        self._server.broadcast_playback_state(
            PlaybackState(getattr(PlaybackStatus, status), log_ns, rate, jumped, request)
        )

    def forget(self) -> None:
        """Let every viewer forget what it has: the time goes back."""
        self._server.clear_session()

    def say(self, text: str, *, warning: bool = False) -> None:
        self._server.publish_status(text, StatusLevel.Warning if warning else StatusLevel.Info)

    def fell_behind(self) -> bool:
        """Whether messages were dropped for a client that took too few, since the last call; viewers are told."""
        dropped = self._drops.again()
        if dropped:
            self.say(FELL_BEHIND, warning=True)
        return dropped

    def close(self) -> None:
        self._drops.close()
        self._server.stop()


def _start_server(host: str, ports: Sequence[int], **settings: Any) -> WebSocketServer:
    for port in ports:
        try:
            return foxglove.start_server(host=host, port=port, **settings)
        except RuntimeError as error:  # all that the SDK raises
            said = str(error).removeprefix("FoxgloveError: ")
            problem = FleetError(f"cannot listen on {host}:{port}: {said}", status=3)
    raise problem


class _Listener(ServerListener):
    """Puts into a queue what clients ask for; called on threads of the SDK's."""

    def __init__(self, events: SimpleQueue[Subscription | PlaybackRequest], numbers: dict[int, list[int]]) -> None:
        self._events, self._numbers = events, numbers

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._changed(client, channel, wanted=True)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self._changed(client, channel, wanted=False)

    def _changed(self, client: Client, channel: ChannelView, *, wanted: bool) -> None:
        for number in self._numbers[channel.id]:
            self._events.put(Subscription(number, client.id, wanted))

    def on_playback_control_request(self, playback_control_request: PlaybackControlRequest) -> None:
        asked = playback_control_request
        play = asked.playback_command == PlaybackCommand.Play
        self._events.put(PlaybackRequest(play, asked.playback_speed, asked.seek_time, asked.request_id))


class _Drops(logging.Handler):
    """Takes what the SDK logs, and notes when it says that it drops messages: it counts them nowhere."""

    def __init__(self) -> None:
        super().__init__()
        self._seen = False
        self._logger = logging.getLogger("foxglove")
        self._logger.setLevel(logging.INFO)
        self._logger.propagate = False
        self._logger.addHandler(self)
        foxglove.set_log_level("INFO")

    def emit(self, record: logging.LogRecord) -> None:
        self._seen = self._seen or record.name == _DROPPING

    def again(self) -> bool:
        seen, self._seen = self._seen, False
        return seen

    def close(self) -> None:
        self._logger.removeHandler(self)
        super().close()


def _service(offer: ServiceOffer) -> Service:
    def handle(request: ServiceRequest) -> bytes:
        asked: Any = None
        with suppress(ValueError):
            asked = json.loads(request.payload or b"{}")
        if not isinstance(asked, dict):
            raise FleetError(f"{offer.name} takes a JSON object")
        known = offer.request.get("properties", asked)  # a schema without them says nothing of keys
        if unknown := [key for key in asked if key not in known]:
            name = offer.name.rpartition("/")[2]
            raise FleetError(f"{name} takes {', '.join(known) or 'nothing'}, not {unknown[0]:.40}")
        return json.dumps(offer.call(asked)).encode()

    return Service(
        offer.name,
        schema=ServiceSchema(offer.name, request=_json(f"{offer.name}/request", offer.request),
                             response=_json(f"{offer.name}/answer", offer.answer)),
        handler=handle,
    )  # fmt: skip


def _json(name: str, schema: dict[str, Any]) -> MessageSchema:
    described = foxglove.Schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())
    return MessageSchema(encoding="json", schema=described)
