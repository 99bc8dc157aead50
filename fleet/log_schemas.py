"""What the log's messages look like: protobuf descriptors built from the declarations, without protoc.

Poses use Foxglove's own schema, so that every viewer draws them; the rest is ours, one flat message per topic
group. Units and meanings travel as channel metadata, because a protobuf field has no place for them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FileDescriptor

from agents.signals import Signal

PACKAGE = "uuv_fleet"
DOUBLE = descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE
UINT32 = descriptor_pb2.FieldDescriptorProto.TYPE_UINT32
STRING = descriptor_pb2.FieldDescriptorProto.TYPE_STRING
BYTES = descriptor_pb2.FieldDescriptorProto.TYPE_BYTES


@dataclass(frozen=True, slots=True)
class Column:
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


STATE = tuple(
    Column(name, unit, meaning)
    for name, unit, meaning in (
        ("x", "m", "north"), ("y", "m", "east"), ("z", "m", "down"),
        ("theta", "rad", "pitch"), ("psi", "rad", "yaw, unwrapped"),
        ("u", "m/s", "surge over ground"), ("v", "m/s", "sway over ground"), ("w", "m/s", "heave over ground"),
        ("q", "rad/s", "pitch rate"), ("r", "rad/s", "yaw rate"),
    )
)  # fmt: skip
COMMAND = (
    Column("tau", "N, N m, N m", "surge force, pitch and yaw moment as the agent commanded them", 3),
    Column("applied", "N, N m, N m", "the same as the actuators applied them over the following tick", 3),
)
ERROR = (
    Column("e", "m", "consensus error from true positions, NED", 3),
    Column("e_norm", "m", "its Euclidean norm"),
    Column("formation", "m", "true position minus desired position, NED", 3),
    Column("formation_norm", "m", "its Euclidean norm"),
)
PACKET = (
    Column("seq", "1", "number of the payload on this directed link", type=UINT32),
    Column("copy", "1", "0 for the original, 1.. for duplicates", type=UINT32),
    Column("sent", "s", "sending time"),
    Column("due", "s", "time from which it is, or would have been, usable"),
    Column("delay", "s", "drawn delay of the link, before rounding up to ticks"),
    Column("fate", "", "delivered, in flight, or the cause of the loss", type=STRING),
    Column("payload", "", "the payload's bytes", type=BYTES),
)


def signal_columns(signals: tuple[Signal, ...], group: str) -> tuple[Column, ...]:
    """The columns of a controller's telemetry group."""
    return tuple(Column(s.name, s.unit, s.meaning, 0 if s.width == 1 else s.width) for s in signals if s.group == group)


def flat_schema(name: str, columns: tuple[Column, ...]) -> Schema:
    """A schema of our own."""
    file = descriptor_pb2.FileDescriptorProto(name=f"{PACKAGE}/{name}.proto", package=PACKAGE, syntax="proto3")
    message = file.message_type.add(name=name)
    for number, column in enumerate(columns, start=1):
        repeated = descriptor_pb2.FieldDescriptorProto.LABEL_REPEATED
        optional = descriptor_pb2.FieldDescriptorProto.LABEL_OPTIONAL
        message.field.add(
            name=column.name,
            number=number,
            type=column.type,
            label=repeated if column.width else optional,
        )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    descriptor = pool.FindMessageTypeByName(f"{PACKAGE}.{name}")
    units = {column.name: [column.unit, column.meaning] for column in columns}
    return Schema(
        f"{PACKAGE}.{name}",
        _descriptor_set(descriptor.file),
        message_factory.GetMessageClass(descriptor),
        json.dumps(units),
    )


def pose_schema() -> Schema:
    """Foxglove's pose in a frame: position [m, NED] and orientation (body to NED, roll zero)."""
    units = {
        "pose.position": ["m", "north, east, down"],
        "pose.orientation": ["1", "unit quaternion, body to NED"],
    }
    return Schema("foxglove.PoseInFrame", _descriptor_set(PoseInFrame.DESCRIPTOR.file), PoseInFrame, json.dumps(units))


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
