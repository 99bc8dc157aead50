"""A node of ROS 2 on one zenoh session: publishers, subscriptions and services, with their tokens and attachments."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from fleet.addons.robots.ros2.rmw import (
    DEFAULT,
    TOKENS,
    Entity,
    EntityKind,
    Qos,
    RmwAttachment,
    check_name,
    gid_of,
    node_token,
    pack,
    read_token,
    unpack,
)  # fmt: skip
from fleet.addons.robots.ros2.types import RosTypes
from fleet.errors import FleetError
from netem.errors import BusError
from netem.wire.listening import probe_address
from netem.wire.ros_bus import SESSION_FILE, SETTINGS, RosBus, RosSample

HOST, PORT = "127.0.0.1", 7447  # where rmw_zenoh looks for its router


def open_ros_session(connect: str | None, listen: str | None) -> tuple[RosBus, str]:
    """A session: as asked, else as rmw_zenoh's variables say, else at the usual router of this host, hosted if need be.
    `connect`: the endpoint of a router to join. `listen`: the endpoint of a router to be. Returns the session, and in
    words what it is. Raises FleetError: there is no router, or the endpoint is taken, or the settings are none."""
    try:
        if connect is not None:
            return _join(connect)
        if listen is not None:
            return RosBus.be_router(listen), f"a router at {listen}"
        if (bus := RosBus.as_configured()) is not None:
            return bus, f"as {SESSION_FILE} or {SETTINGS} say, {bus.endpoint or 'no endpoint'}"
        usual = f"tcp/{HOST}:{PORT}"
        try:
            probe_address(HOST, PORT)
        except OSError:
            return _join(usual)
        return RosBus.be_router(usual), f"a router at {usual}, this host only"
    except BusError as error:
        raise FleetError(str(error), status=3) from None


def _join(endpoint: str) -> tuple[RosBus, str]:
    try:
        return RosBus.join(endpoint), f"joined the router at {endpoint}"
    except BusError as error:
        raise FleetError(f"{error}; a router of ROS 2: ros2 run rmw_zenoh_cpp rmw_zenohd", status=3) from None


MOST_TOLD = 100  # problems that wait to be told


def wall_ns() -> int:
    """Wall time [ns since 1970]: attachments are compared with those of others."""
    return time.time_ns()  # noqa: TID251 (attachments are in wall time)


class RosPublisher:
    """Publishes messages of one type on one topic."""

    def __init__(self, bus: RosBus, types: RosTypes, entity: Entity, token: str, qos: Qos, *, drop: bool) -> None:
        self._types, self._type = types, entity.type
        self._gid = gid_of(token)
        self._sequence = 0
        self._plain = None if qos.transient_local else bus.plain(entity.key, drop=drop)
        self._put = bus.latched_publisher(entity.key) if self._plain is None else self._plain.put

    @property
    def matched(self) -> bool:
        """Whether there is a subscriber. Messages that are kept for later subscribers count as wanted."""
        return self._plain is None or self._plain.matched

    def publish(self, message: Any) -> None:
        """Publish a message. Raises FleetError: it is none of the type."""
        self._sequence += 1
        data = self._types.encode(self._type, message)
        self._put(data, pack(RmwAttachment(self._sequence, wall_ns(), self._gid)))


class RosNode:
    """One node. Handlers run on threads of zenoh; what is wrong with messages of others waits in `problems`."""

    def __init__(self, bus: RosBus, types: RosTypes, domain: int, name: str) -> None:
        """Declare it. Raises FleetError: the domain has a node of this name."""
        self.name, self.domain, self.types = name, domain, types
        self.problems: deque[str] = deque(maxlen=MOST_TOLD)
        self._bus, self._number = bus, 0
        self._told: set[str] = set()
        self._clients: dict[str, tuple[Entity, bytes]] = {}
        self._calls = 0
        self._types_of: dict[str, Entity] = {}
        if bus.tokens(f"{TOKENS}/{domain}/*/*/*/NN/*/*/{name}"):
            raise FleetError(
                f"domain {domain} has a node {name} already: another fleet is shown there. Choose another domain with "
                "--domain or ROS_DOMAIN_ID",
                status=3,
            )
        bus.token(node_token(domain, bus.id, name))
        bus.watch_tokens(f"{TOKENS}/{domain}/**", self._look)

    def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT, *, drop: bool = True) -> RosPublisher:
        """Publish on a topic from now on. `drop`: what a slow subscriber has no room for is lost to it; otherwise
        publishing waits. Raises FleetError: it has no such name, or the type is not known."""
        entity, token = self._declare(topic, type_name, "MP", qos)
        return RosPublisher(self._bus, self.types, entity, token, qos, drop=drop)

    def subscribe(self, topic: str, type_name: str, handler: Callable[[Any], None]) -> None:
        """Call `handler` with each message of a topic. Raises FleetError, as for `publisher`."""
        entity, _ = self._declare(topic, type_name, "MS", DEFAULT)

        def receive(sample: RosSample) -> None:
            try:
                unpack(sample.attachment)
                message = self.types.decode(type_name, sample.payload)
            except ValueError as error:
                self._tell(f"dropped a message on {topic}: {error}")
                return
            handler(message)

        self._bus.hear(entity.key, receive)

    def serve(self, service: str, type_name: str, handler: Callable[[Any], Any]) -> None:
        """Answer calls of a service with what `handler` makes of a request. Raises FleetError, as for `publisher`."""
        entity, _ = self._declare(service, type_name, "SS", DEFAULT)

        def answer(sample: RosSample) -> tuple[bytes, bytes] | None:
            try:
                asked = unpack(sample.attachment)
                request = self.types.decode(f"{type_name}_Request", sample.payload)
            except ValueError as error:
                self._tell(f"dropped a call of {service}: {error}")
                return None
            response = self.types.encode(f"{type_name}_Response", handler(request))
            return response, pack(RmwAttachment(asked.sequence, wall_ns(), asked.gid))

        self._bus.serve(entity.key, answer)

    def call(self, service: str, type_name: str, request: Any) -> Any:
        """The answer of a service to a request; None: no answer came. Raises ValueError: the answer is none of the
        type."""
        if service not in self._clients:
            entity, token = self._declare(service, type_name, "SC", DEFAULT)
            self._clients[service] = entity, gid_of(token)
        entity, gid = self._clients[service]
        self._calls += 1
        data = self.types.encode(f"{type_name}_Request", request)
        answer = self._bus.call(entity.key, data, pack(RmwAttachment(self._calls, wall_ns(), gid)))
        return None if answer is None else self.types.decode(f"{type_name}_Response", answer)

    def publishers_of(self, topic: str) -> bool:
        entity = self._types_of[topic]
        mangled = topic.replace("/", "%")
        found = self._bus.tokens(f"{TOKENS}/{self.domain}/*/*/*/MP/*/*/*/{mangled}/**")
        return any((known := read_token(token)) and known[2] == entity for token in found)

    def _declare(self, name: str, type_name: str, kind: EntityKind, qos: Qos) -> tuple[Entity, str]:
        entity = Entity(self.domain, check_name(name), type_name, self.types.hash(type_name))
        self._number += 1
        token = entity.token(self._bus.id, self.name, self._number, kind, qos)
        self._types_of[name] = entity
        self._bus.token(token)
        return entity, token

    def _look(self, token: str, there: bool) -> None:
        """Others may have one of our topics with another type, or another version of it: zenoh joins no two of them."""
        found = read_token(token) if there else None
        if found is None or found[2].name not in self._types_of:
            return
        node, _, theirs = found
        ours = self._types_of[theirs.name]
        if theirs.type != ours.type:
            self._tell(f"node {node} has {theirs.type} on {theirs.name}, where {ours.type} is expected")
        elif theirs.hash != ours.hash:
            self._tell(
                f"node {node} has another version of {theirs.type} on {theirs.name} ({theirs.hash:.19}..., expected "
                f"{ours.hash:.19}...): it is of another distribution than {self.types.distribution}; see --distro"
            )

    def _tell(self, text: str) -> None:
        """Once each."""
        if text not in self._told and len(self._told) < MOST_TOLD:
            self._told.add(text)
            self.problems.append(text)
