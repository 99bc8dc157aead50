"""The form of the log's messages: protobuf descriptors built from the declarations, without protoc.

Poses use Foxglove's own schema, so that every viewer draws them; the rest is ours, one flat message per topic
group. Units and meanings travel as channel metadata, because a protobuf field has no place for them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from struct import Struct
from typing import Any

from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.timestamp_pb2 import Timestamp

from fleet.scenario.sections import signals
from netem.wire.messages import END, ERR, FAILED, OUT, Said
from world.signal import Signal

PACKAGE = "uuv_fleet"
NODES = "nodes"  # key in metadata `run`: the names of the nodes, in the order of their numbers; `node_names`
CLOCK = "clock"  # key in metadata `run`, where the run was not in lockstep, and so is not repeatable
START = "start.json"  # the attachment of a log that holds where its run began, if that went on from another
OLD_START = "start.msgpack"  # START in a log with snapshots, as versions before wrote it
SNAPSHOTS = "snapshot"  # a topic of logs with snapshots, which no command reads any more
FROM, FROM_TICK = "from", "from tick"  # what the metadata of a run say that goes on from another
DOUBLE = descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE
UINT32 = descriptor_pb2.FieldDescriptorProto.TYPE_UINT32
STRING = descriptor_pb2.FieldDescriptorProto.TYPE_STRING
BYTES = descriptor_pb2.FieldDescriptorProto.TYPE_BYTES
BOOL = descriptor_pb2.FieldDescriptorProto.TYPE_BOOL


@dataclass(frozen=True, slots=True)
class MessageField:
    """One field of a log message; `width` 0 is a single value, more is an array."""

    name: str
    unit: str
    meaning: str
    width: int = 0
    type: int = DOUBLE


@dataclass(frozen=True, slots=True)
class Schema:
    """A log message type: its name, its self-contained descriptor set, its class and its columns."""

    name: str
    descriptor_set: bytes
    message: Callable[..., Any]
    units: str  # JSON: column -> [unit, meaning]


def node_names(run: Mapping[str, str]) -> list[str]:
    """The names of the nodes, by the metadata `run` of a log; none: it is of vehicles."""
    return run.get(NODES, "").split()


def signal_columns(declared: tuple[Signal, ...]) -> tuple[MessageField, ...]:
    return tuple(MessageField(s.name, s.unit, s.meaning, 0 if s.width == 1 else s.width) for s in declared)


STATE, ROLL, COMMAND, ERROR, CLOCK_ERROR, BELIEF, LOCATED = map(
    signal_columns,
    (signals.STATE, signals.ROLL, signals.COMMAND, signals.ERROR, signals.CLOCK, signals.BELIEF, signals.LOCATED),
)
FIX = (
    MessageField("source", "", "gps, usbl or lbl", type=STRING),
    MessageField("measured", "s", "when it was measured"),
    MessageField("at", "s", "when the navigation got it"),
    MessageField("north", "m", "the fix"),
    MessageField("east", "m", "the fix"),
    MessageField("sigma", "m", "standard deviation that it has by itself, on each axis"),
    MessageField("nis", "1", "normalised square of its innovation; chi-square with 2 degrees of freedom"),
    MessageField("used", "", "false: the filter refused it", type=BOOL),
)
FAULT = (
    MessageField("fault", "", "its id", type=STRING),
    MessageField("action", "", "begins or ends", type=STRING),
    MessageField("what", "", "in the words of a scenario", type=STRING),
)
PACKET = (
    MessageField("seq", "1", "number of the payload on this directed link", type=UINT32),
    MessageField("copy", "1", "0 for the original, 1.. for duplicates", type=UINT32),
    MessageField("sent", "s", "sending time"),
    MessageField("due", "s", "time from which it is, or would have been, usable"),
    MessageField("delay", "s", "drawn delay of the link, before rounding up to ticks"),
    MessageField("fate", "", "delivered, in flight, or the cause of the loss", type=STRING),
    MessageField("payload", "", "the payload's bytes, as they arrived", type=BYTES),
    MessageField("corrupted", "", "whether the link changed the payload", type=BOOL),
)
RANGED = (
    *PACKET,
    MessageField("range", "m", "to the sender, as the receiver's modem measured it; NaN: it has not"),
    MessageField("range_sd", "m", "its standard deviation, as the modem knows it"),
    MessageField("ranged", "s", "when the vehicles were so far apart"),
    MessageField("distance", "m", "their true distance then"),
    MessageField("range_error", "m", "the range minus that distance"),
)
CARRIED = (
    *PACKET,
    MessageField("key", "", "of its message: zenoh's, udp/<port>, or modem/<address>/<protocol>", type=STRING),
    MessageField("kind", "", "put, delete, query, reply, datagram or modem", type=STRING),
    MessageField("size", "bytes", "of the packet with its header", type=UINT32),
)
# By name, the schemas that every log of a run may have.
_OURS = {"State": STATE, "StateWithRoll": STATE + ROLL, "Command": COMMAND, "Error": ERROR, "Clock": CLOCK_ERROR}
_OURS |= {"Belief": BELIEF, "Fix": FIX, "Located": LOCATED, "Fault": FAULT}
_OURS |= {"Packet": PACKET, "RangedPacket": RANGED, "CarriedPacket": CARRIED}
OURS = {f"{PACKAGE}.{name}": columns for name, columns in _OURS.items()}


@lru_cache(maxsize=256)  # vehicles with the same laws share one
def flat_schema(name: str, columns: tuple[MessageField, ...]) -> Schema:
    """A schema of our own; dots in the name put it into packages below ours."""
    below, _, name = name.rpartition(".")
    package = f"{PACKAGE}.{below}" if below else PACKAGE
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{package.replace('.', '/')}/{name}.proto", package=package, syntax="proto3"
    )
    message = file.message_type.add(name=name)
    for number, column in enumerate(columns, start=1):
        kinds = descriptor_pb2.FieldDescriptorProto
        label = kinds.LABEL_REPEATED if column.width else kinds.LABEL_OPTIONAL
        message.field.add(name=column.name, number=number, type=column.type, label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    descriptor = pool.FindMessageTypeByName(f"{package}.{name}")
    units = {column.name: [column.unit, column.meaning] for column in columns}
    return Schema(
        f"{package}.{name}",
        _descriptor_set(descriptor.file),
        message_factory.GetMessageClass(descriptor),
        json.dumps(units),
    )


class Doubles:
    """Protobuf wire format of a message that holds doubles only, zeros too: bytes that never change, and the doubles.

    So many messages of a tick can be encoded at once, without protobuf's own message objects
    (`fleet.recorder.tick_messages`). A test parses the result with protobuf and compares.
    """

    def __init__(self, columns: Sequence[MessageField], start: int = 0, field: int = 1) -> None:
        """Lay out a message, or the part of one. `start`: the number of the first column's first double. `field`: the
        number of the first column in the message.
        """
        self.parts: list[bytes | int] = []  # the message: bytes as they are, and the numbers of the doubles
        layout = "<"
        for number, column in enumerate(columns, start=field):
            before = head(number, column.width or None)
            width = column.width or 1
            self.parts += (before, *range(start, start + width))
            layout += f"{len(before)}x{width}d"
            start += width
        self._struct = Struct(layout)

    @property
    def size(self) -> int:
        """The length of the message [bytes]."""
        return self._struct.size

    def decode(self, data: bytes) -> tuple[float, ...]:
        """The values of this message's columns, in order. Raises struct.error if it is none of these messages."""
        return self._struct.unpack(data)


def pose_parts(frame_id: str, position: int, orientation: int) -> list[bytes | int]:
    """The bytes behind the timestamp in Foxglove's PoseInFrame, as in `Doubles.parts`. `position`: the number of the
    first of its three doubles; `orientation`: of its four.
    """
    place = Doubles([MessageField(name, "", "") for name in "xyz"], position)
    turn = Doubles([MessageField(name, "", "") for name in "xyzw"], orientation)
    pose = b"\x0a" + varint(place.size), b"\x12" + varint(turn.size)
    size = sum(map(len, pose)) + place.size + turn.size
    frame = b"\x12" + varint(len(frame_id)) + frame_id.encode()
    return [frame + b"\x1a" + varint(size) + pose[0], *place.parts, pose[1], *turn.parts]


def head(number: int, width: int | None) -> bytes:
    """The bytes before the doubles of a field: its tag, and for a packed array of `width` the length in bytes."""
    # Wire type 1 is a single double, 2 whatever has a length.
    return varint(number << 3 | 1) if width is None else varint(number << 3 | 2) + varint(8 * width)


@lru_cache(maxsize=4096)
def varint(value: int) -> bytes:
    """A number as protobuf writes it, seven bits a byte."""
    out = b""
    while value > 0x7F:
        out += bytes((value & 0x7F | 0x80,))
        value >>= 7
    return out + bytes((value,))


def pose_schema() -> Schema:
    """Foxglove's pose in a frame: position [m, NED] and orientation (body to NED)."""
    units = {
        "pose.position": ["m", "north, east, down"],
        "pose.orientation": ["1", "unit quaternion, body to NED"],
    }
    return foxglove_schema(PoseInFrame, units)


LEVELS = {OUT: Log.INFO, ERR: Log.WARNING, END: Log.INFO, FAILED: Log.ERROR}


@lru_cache(maxsize=1)
def said_schema() -> Schema:
    """Foxglove's log message, which viewers show as a list of lines. Its `file` is the stream."""
    units = {
        "timestamp": ["s", "when it was said"],
        "message": ["", "the line"],
        "name": ["", "who said it"],
        "file": ["", "out, err; end or failed: how its program ended"],
    }
    return foxglove_schema(Log, units)


def said_data(who: str, said: Said) -> bytes:
    """A line as a message of `said_schema`."""
    log = Log(
        timestamp=stamp_of(said.at_ns),
        level=LEVELS.get(said.stream, Log.INFO),
        message=said.text,
        name=who,
        file=said.stream,
    )
    return log.SerializeToString()


def foxglove_schema(message: Any, units: Mapping[str, Sequence[str]]) -> Schema:
    """One of Foxglove's own schemas, by its message class; `units`: field -> (unit, meaning)."""
    descriptor = message.DESCRIPTOR
    return Schema(descriptor.full_name, _descriptor_set(descriptor.file), message, json.dumps(units))


def _descriptor_set(file: FileDescriptor) -> bytes:
    files: dict[str, descriptor_pb2.FileDescriptorProto] = {}

    def add(descriptor: FileDescriptor) -> None:
        if descriptor.name in files:
            return
        for dependency in descriptor.dependencies:
            add(dependency)
        proto = descriptor_pb2.FileDescriptorProto()
        descriptor.CopyToProto(proto)
        files[descriptor.name] = proto

    add(file)
    descriptors = descriptor_pb2.FileDescriptorSet(file=files.values())
    return descriptors.SerializeToString(deterministic=True)


def stamp_field(ns: int) -> bytes:
    """A time as field 1 of a message, which it is in all messages of Foxglove's: a google.protobuf.Timestamp."""
    stamp = stamp_of(ns).SerializeToString()
    return b"\x0a" + varint(len(stamp)) + stamp


def stamp_of(ns: int) -> Timestamp:
    seconds, nanos = divmod(ns, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)
