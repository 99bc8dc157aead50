"""The messages of any log as flat (field, value) pairs with units, decoded by the schema that stands in the log."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import islice
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError, Message
from mcap.records import Channel, Schema

from fleet.logs.schemas import OURS, MessageField
from fleet.mcap.reader import LogReader, LogReadError, Record
from fleet.scenario.sections.signals import component
from netem.limits import LOG_MESSAGE

UNITS = "units"  # what of a channel's metadata says them, as JSON: field -> [unit, meaning]


class FieldValue(NamedTuple):
    """One number, text or flag of a message; `path` as in `pose.position.x`, `tau_0` or `transforms[2].parent`."""

    path: str
    value: Any
    unit: str


def decode_message(cls: Any, data: bytes) -> Any:
    """Decode a message of a protobuf class. Raises DecodeError if it is damaged, or longer than LOG_MESSAGE.bytes."""
    if len(data) > LOG_MESSAGE.bytes:
        raise DecodeError(f"a message of {len(data)} bytes, more than the {LOG_MESSAGE.bytes} that are decoded")
    return cls.FromString(data)


class Decoder:
    """Decodes what a reader yields. Other data than readable protobuf is one field of bytes."""

    def __init__(self, reader: LogReader) -> None:
        self._reader = reader
        self._known: dict[str, tuple[Any, dict[str, str]]] = {}
        self._checked: set[str] = set()

    def __call__(self, record: Record) -> list[FieldValue]:
        message = self.message(record)
        if message is None:
            return [FieldValue("bytes", record.data, "")]
        units = self._known[record.topic][1]
        values = list(islice(_flat(message, units), LOG_MESSAGE.items + 1))
        return values if len(values) <= LOG_MESSAGE.items else [FieldValue("bytes", record.data, "")]

    def message(self, record: Record) -> Any:
        """The protobuf message of a record; None if it is none."""
        if record.topic not in self._known:
            channel = self._reader.channel(record.topic)
            if channel is None:
                return None
            self._known[record.topic] = known_class(self._reader.schemas.get(channel.schema_id)), units_of(channel)
        cls = self._known[record.topic][0]
        try:
            return None if cls is None else decode_message(cls, record.data)
        except DecodeError:
            return None

    def ours(self, record: Record, columns: Iterable[MessageField], *, lacking: bool = False) -> Any:
        """The message of a record that a run of ours wrote; None if this one message is damaged. `lacking`: whether a
        field may be missing. Raises LogReadError if the log's schema of the topic is damaged, or is another one.
        """
        topic = record.topic
        message = self.message(record)
        if topic not in self._checked:
            self._checked.add(topic)
            cls = self._known[topic][0] if topic in self._known else None
            if problem := _unlike(cls, columns, lacking=lacking):
                raise LogReadError(f"{self._reader.path}: the schema of {topic} cannot be used: {problem}")
        return message


def message_class(schema: Schema) -> Any:
    """The class of the messages that a protobuf schema in a log describes. Raises DecodeError, TypeError, KeyError if
    it describes none, or has a name of ours and fields of another type.
    """
    return _message_class(schema.name, schema.data)


@lru_cache(maxsize=32)  # thousands of topics share a few schemas
def _message_class(name: str, data: bytes) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
        pool.Add(file)
    found = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    if problem := _unlike(found, OURS.get(name, ()), lacking=True):
        raise TypeError(problem)
    return found


def known_class(schema: Schema | None) -> Any:
    """The same; None of a schema that is not protobuf, or damaged."""
    if schema is None or schema.encoding != "protobuf":
        return None
    try:
        return message_class(schema)
    except (DecodeError, TypeError, KeyError):  # a foreign file may hold anything
        return None


def _unlike(cls: Any, columns: Iterable[MessageField], *, lacking: bool) -> str:
    """The reason why these columns of a class of messages cannot be used; "": they can."""
    if cls is None:
        return "it is damaged, or not one of protobuf"
    fields = cls.DESCRIPTOR.fields_by_name
    for column in columns:
        if column.name not in fields:
            if not lacking:
                return f"it has no field {column.name!r}"
        elif fields[column.name].type != column.type or fields[column.name].is_repeated != bool(column.width):
            return f"its field {column.name!r} is of another type"
    return ""


def units_of(channel: Channel) -> dict[str, str]:
    """The unit of each field that has one, by the channel's metadata. Empty if the metadata cannot be read."""
    return {name: unit for name, (unit, _) in field_meanings(channel).items()}


def field_meanings(channel: Channel) -> dict[str, tuple[str, str]]:
    """(unit, meaning) of each field that has them, by the channel's metadata; empty of a channel that is not ours."""
    try:
        declared = json.loads(channel.metadata.get(UNITS, "{}")).items()
        return {name: (str(unit), str(meaning)) for name, (unit, meaning) in declared}
    except (ValueError, TypeError, AttributeError):
        return {}


def _unit(units: dict[str, str], name: str, k: int | None = None) -> str:
    """The unit of a field, or of the message that it stands in. `name`: of the field, with the names of the messages
    around it: within the messages of a list all units are alike. `k`: which component of it.
    """
    found = name
    while found not in units and "." in found:
        found = found.rpartition(".")[0]
    unit = units.get(found, "")
    each = unit.split(", ")
    return each[k] if k is not None and found == name and k < len(each) > 1 else unit


def _flat(message: Message, units: dict[str, str], prefix: str = "", around: str = "") -> Iterator[FieldValue]:
    """Every value of a message; `prefix` and `around` are the path and the names of the messages that it stands in."""
    known = message.DESCRIPTOR.fields_by_name
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        path, name = prefix + field.name, around + field.name
        if not field.is_repeated:
            if isinstance(value, Message):
                yield from _flat(value, units, f"{path}.", f"{name}.")
            else:
                yield FieldValue(path, value, _unit(units, name))
            continue
        for k, element in enumerate(value):
            if isinstance(element, Message):
                yield from _flat(element, units, f"{path}[{k}].", f"{name}.")
            else:
                other = component(field.name, k) in known  # a field of its own
                yield FieldValue(f"{path}[{k}]" if other else component(path, k), element, _unit(units, name, k))
