"""Messages of robots in the log, with the schema of ROS 2 if their type is known, and the places that topics give."""

from __future__ import annotations

from contextlib import suppress
from math import pi

from agents.payload import MAX_SUM
from fleet.addons.robots.ros2.rmw import read_key
from fleet.addons.robots.ros2.types import types_of
from fleet.errors import FleetError
from fleet.recorder.log_file import LogFile, NoLog
from fleet.recorder.transforms import angles, enu
from fleet.replay.capture import message_encoding
from netem.relay_messages import LoggedMessage

_PLACES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped")
_MOST_CHANNELS = 10_000  # MCAP has 65,535 of them


class MessageLog:
    """Writes messages into a log: a channel for each robot and key."""

    def __init__(self, log: LogFile | NoLog, tick_ns: int, names: tuple[str, ...]) -> None:
        self._log, self._tick_ns, self._names = log, tick_ns, names
        self._channels: dict[tuple[int, str, str, str], int] = {}
        self._count = 0

    def write(self, message: LoggedMessage) -> None:
        """Append a message at the time at which it came. Raises LogError."""
        name = message.src, message.key, message.kind, message.encoding
        if name not in self._channels:
            if len(self._channels) >= _MOST_CHANNELS:
                return
            self._channels[name] = self._channel(message)
        at_ns = message.tick * self._tick_ns
        self._count += 1
        self._log.message(self._channels[name], at_ns, at_ns, self._count & 0xFFFFFFFF, message.payload)

    def _channel(self, message: LoggedMessage) -> int:
        robot, entity = self._names[message.src - 1], read_key(message.key)
        metadata = {"zenoh.key": message.key, "zenoh.kind": message.kind, "zenoh.encoding": message.encoding}
        if entity is not None and message.kind == "put":
            topic = f"{robot}{entity.name}"
            with suppress(FleetError):  # without the extra a message has its bytes and no schema
                types = types_of()
                if entity.type in types.store.fielddefs:
                    schema = entity.type, "ros2msg", types.definition(entity.type).encode()
                    return self._log.other_channel(topic, "cdr", schema, metadata)
            return self._log.other_channel(topic, "application/cdr", None, metadata)
        return self._log.other_channel(f"{robot}/{message.key}", message_encoding(message.encoding), None, metadata)


def place_of(key: str, payload: bytes) -> tuple[float, float, float, float]:
    """The place of a robot: north, east, down [m] and yaw [rad], from a message of ROS (east, north, up). Raises
    FleetError: the topic has another type, the message cannot be decoded, or its place is not finite.
    """
    entity = read_key(key)
    if entity is None or entity.type not in _PLACES:
        kind = "no topic of ROS 2" if entity is None else entity.type
        raise FleetError(f"{key:.80} says no place: expected {' or '.join(_PLACES)}, got {kind}")
    try:
        message = types_of().decode(entity.type, payload)
    except ValueError as error:
        raise FleetError(f"{key:.80}: {error}") from None
    pose = message.pose.pose if entity.type == _PLACES[0] else message.pose
    p, q = pose.position, pose.orientation
    if not all(abs(value) <= MAX_SUM for value in (p.x, p.y, p.z, q.x, q.y, q.z, q.w)):  # nan, too
        raise FleetError(f"{key:.80} says no place: {p.x:g} {p.y:g} {p.z:g} m is not finite, or beyond {MAX_SUM:g} m")
    _, _, yaw = angles(q.x, q.y, q.z, q.w)  # from east, anticlockwise
    return *enu((p.x, p.y, p.z)), pi / 2.0 - yaw  # enu is its own inverse
