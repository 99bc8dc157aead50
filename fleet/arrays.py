"""A log as numpy arrays, by topic and field: `fleet.open_log`.

The file is read once, message by message, into one buffer of bytes per topic; a topic is decoded when one of its fields
is first asked for, by the schema that the file itself carries. A message of doubles only has a fixed layout, so all of
a topic's messages are one structured array; what has another layout is decoded by protobuf, message by message.
"""

from __future__ import annotations

import json
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.records import Channel, Schema

from fleet.log_schemas import head
from fleet.log_values import message_class
from fleet.reader import LogReader, LogReadError, log_path
from netem.grammar import nearest

if TYPE_CHECKING:
    from fleet.scenario import Scenario

Array = np.ndarray[Any, np.dtype[Any]]
_TELL_EVERY = 20_000  # messages


class LogKeyError(LogReadError, KeyError):
    """The log has no such topic, or the topic no such field."""

    __str__ = LogReadError.__str__  # KeyError's would put it in quotes


class FaultInterval(NamedTuple):
    """A fault of the log: from when to when it lasted [s]; one that was cut off lasts to the log's end."""

    id: str
    begin: float
    end: float
    what: str


class Topic:
    """The messages of one topic in the order of the file: `.t` [s] and one array per field.

    A field is an attribute (`topic.x`) and an item (`topic["x"]`, also where its name is one of these here): shape
    (samples,), or (samples, width) for a vector; text and bytes are arrays of objects.
    """

    def __init__(self, name: str, channel: Channel, schema: Schema | None) -> None:
        self.name = name
        self.schema = schema.name if schema is not None else ""
        self._declared = schema if schema is not None and _is_protobuf(channel, schema) else None
        self._data = bytearray()
        self._lengths = array("I")
        self._times = array("Q")  # log and publish time of each message [ns]
        self._numbers = array("Q")
        self._columns: dict[str, Array] | None = None
        self._told: dict[str, tuple[str, str]] = _units(channel.metadata)

    def add(self, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Take one more message, before the first look at the fields."""
        self._times.extend((log_ns, publish_ns))
        self._numbers.append(sequence)
        self._lengths.append(len(data))
        self._data += data

    def __len__(self) -> int:
        return len(self._numbers)

    def __repr__(self) -> str:
        units = self.units
        shown = ", ".join(f"{name} [{units[name]}]" if units[name] else name for name in self.fields)
        return f"<{self.name}: {len(self)} samples of {shown}>"

    def __getitem__(self, field: str) -> Array:
        columns = self._decoded
        if field not in columns:
            hint = nearest(field, list(columns))
            raise LogKeyError(
                f"{self.name} has no field {field!r}; {hint or 'it has ' + (', '.join(columns) or 'no message')}"
            )
        return columns[field]

    def __getattr__(self, field: str) -> Array:
        if field.startswith("_"):  # pickle, copy and notebooks ask for names of their own
            raise AttributeError(field)
        try:
            return self[field]
        except LogKeyError as error:
            raise AttributeError(str(error)) from None

    def __contains__(self, field: object) -> bool:
        return field in self._decoded

    def __dir__(self) -> Iterable[str]:
        return [*super().__dir__(), *self.fields]

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of the fields, in the order of the schema."""
        return tuple(self._decoded)

    @cached_property
    def t(self) -> Array:
        """When each message was logged, in s of simulated time; of a packet, when it arrived or was lost."""
        return self.log_ns / 1e9

    @property
    def log_ns(self) -> Array:
        """The same in ns, exactly."""
        return np.frombuffer(self._times, np.uint64)[0::2].astype(np.int64)

    @property
    def publish_ns(self) -> Array:
        """When each message was sent, in ns."""
        return np.frombuffer(self._times, np.uint64)[1::2].astype(np.int64)

    @property
    def sequence(self) -> Array:
        """The number of each message: the tick, or of a packet its number on the link."""
        return np.frombuffer(self._numbers, np.uint64).astype(np.int64)

    @property
    def units(self) -> dict[str, str]:
        """The unit of each field as the log states it; "" for text, and where the log says nothing."""
        return {name: self._told.get(name, ("", ""))[0] for name in self.fields}

    @property
    def meanings(self) -> dict[str, str]:
        """What each field means, as the log states it."""
        return {name: self._told.get(name, ("", ""))[1] for name in self.fields}

    @property
    def nested(self) -> bool:
        """Whether a message holds lists of messages, which `fields` has as lists and no table has a place for."""
        return any(
            values.dtype == object and isinstance(value, list)
            for values in self._decoded.values()
            for value in values[:1]
        )

    @property
    def _decoded(self) -> dict[str, Array]:
        if self._columns is None:
            self._columns = self._decode()
            self._data = bytearray()
        return self._columns

    def _messages(self) -> Iterator[bytes]:
        ends = np.cumsum(np.frombuffer(self._lengths, np.uint32), dtype=np.int64).tolist()
        view = memoryview(self._data)
        for begin, end in pairwise([0, *ends]):
            yield bytes(view[begin:end])

    def _decode(self) -> dict[str, Array]:
        if self._declared is None:
            return {"data": _objects(self._messages())}
        try:
            make = message_class(self._declared)
        except (DecodeError, TypeError, KeyError) as error:
            raise LogReadError(f"{self.name}: the log's schema {self.schema} cannot be used ({error})") from error
        try:
            quick = self._structured(make)
            return _read(make, self._messages()) if quick is None else quick
        except DecodeError as error:
            raise LogReadError(f"{self.name}: a message is not what its schema {self.schema} says") from error

    def _structured(self, make: Callable[[], Any]) -> dict[str, Array] | None:
        """All messages at once if each has the same layout of doubles; None if not."""
        lengths = np.frombuffer(self._lengths, np.uint32)
        fields = sorted(make().DESCRIPTOR.fields, key=lambda field: field.number)
        if not len(lengths) or any(field.type != FieldDescriptor.TYPE_DOUBLE for field in fields):
            return None
        first = make()
        first.ParseFromString(bytes(self._data[: lengths[0]]))
        places: dict[str, tuple[int, int]] = {}  # field: (first byte, width or 0)
        heads: list[tuple[int, bytes]] = []
        size = 0
        for field in fields:
            width = len(getattr(first, field.name)) if field.is_repeated else 0
            heads.append((size, head(field.number, width if field.is_repeated else None)))
            size += len(heads[-1][1])
            places[field.name] = size, width
            size += 8 * (width if field.is_repeated else 1)
        if (lengths != size).any():
            return None
        rows = np.frombuffer(self._data, np.uint8).reshape(-1, size)
        if any((rows[:, at : at + len(tag)] != np.frombuffer(tag, np.uint8)).any() for at, tag in heads):
            return None
        return {
            field.name: _doubles(rows, *places[field.name], vector=field.is_repeated)
            for field in make().DESCRIPTOR.fields
        }


class Log:
    """What `open_log` gives: topics by name, and what the log says of itself."""

    def __init__(self, path: Path, topics: dict[str, Topic], reader: LogReader) -> None:
        self.path = path
        self.run = reader.metadata.get("run", {})  # what determined the result: scenario, seed, versions
        self.missing = reader.missing  # why the log is not whole; "" if it is
        self._topics = topics
        self.scenario_text = reader.attachments.get("scenario.yaml", b"").decode("utf-8", "replace")  # "" if none

    def __getitem__(self, topic: str) -> Topic:
        if topic not in self._topics:
            if not isinstance(topic, str):
                raise LogKeyError(f"topics have names such as 'uuv/1/state', got {topic!r}")
            hint = nearest(topic, self.topics)
            raise LogKeyError(f"{self.path} has no topic {topic!r}; {hint or 'see .topics for those it has'}")
        return self._topics[topic]

    def __contains__(self, topic: object) -> bool:
        return topic in self._topics

    def __iter__(self) -> Iterator[str]:
        return iter(self._topics)

    def __len__(self) -> int:
        return len(self._topics)

    def __repr__(self) -> str:
        word = f", NOT WHOLE: {self.missing}" if self.missing else ""
        return f"<{self.path}: {self.messages} messages in {len(self)} topics, {self.end:g} s{word}>"

    @property
    def topics(self) -> list[str]:
        """The names of all topics, also of those without a message."""
        return list(self._topics)

    @property
    def messages(self) -> int:
        """How many messages were read."""
        return sum(len(topic) for topic in self._topics.values())

    @cached_property
    def end(self) -> float:
        """Time of the last message [s]."""
        return max((int(topic.log_ns.max()) for topic in self._topics.values() if len(topic)), default=0) / 1e9

    @property
    def vehicles(self) -> list[int]:
        """The numbers of the vehicles that the log has topics of."""
        found = {int(match[1]) for topic in self if (match := re.match(r"uuv/(\d+)/", topic))}
        return sorted(found)

    @property
    def links(self) -> list[tuple[int, int]]:
        """The directed links (source, destination) that the log has topics of."""
        return sorted((int(m[1]), int(m[2])) for topic in self if (m := re.fullmatch(r"link/(\d+)-(\d+)", topic)))

    @cached_property
    def scenario(self) -> Scenario:
        """The merged scenario that was run, without what was injected into the run. No law of it is imported.

        Raises:
            LogReadError: the log holds none.
            ScenarioError: another version wrote it, and it is none for this one.
        """
        from fleet.scenario import parse_scenario

        if not self.scenario_text:
            raise LogReadError(f"{self.path} holds no scenario: it was not written by fleet run, or cut at its start")
        return parse_scenario(self.scenario_text, str(self.path))

    @cached_property
    def faults(self) -> list[FaultInterval]:
        """The faults in the order in which they began."""
        if "faults" not in self or not len(self["faults"]):
            return []
        topic = self["faults"]
        found: dict[str, FaultInterval] = {}
        for at, name, action, what in zip(topic.t, topic["fault"], topic["action"], topic["what"], strict=True):
            if action == "begins":
                found[name] = FaultInterval(name, float(at), self.end, what)
            elif name in found:
                found[name] = found[name]._replace(end=float(at))
        return list(found.values())


def open_log(
    path: str | Path, topics: Iterable[str] | None = None, progress: Callable[[float], None] = lambda _: None
) -> Log:
    """Read a log, whole or cut, into numpy arrays.

    Args:
        path: an MCAP file, or a run directory.
        topics: keep only the topics that match one of these patterns, such as `uuv/*/state`; None: all.
        progress: told the simulated time [s] now and then.

    Raises:
        LogReadError: there is no log to read.
    """
    file = log_path(Path(path))
    reader = LogReader(file)
    wanted = None if topics is None else [topics] if isinstance(topics, str) else list(topics)
    found: dict[str, Topic | None] = {}

    def keep(name: str) -> Topic | None:
        if wanted is not None and not any(fnmatchcase(name, pattern) for pattern in wanted):
            return None
        channel = next(channel for channel in reader.channels.values() if channel.topic == name)
        return Topic(name, channel, reader.schemas.get(channel.schema_id))

    for number, (name, log_ns, publish_ns, sequence, data) in enumerate(reader):
        if name not in found:
            found[name] = keep(name)
        topic = found[name]
        if topic is not None:
            topic.add(log_ns, publish_ns, sequence, data)
        if number % _TELL_EVERY == 0:
            progress(log_ns / 1e9)
    # In the order of the channels, with those that hold nothing.
    ordered = {channel.topic: None for channel in reader.channels.values()}
    kept = {name: found[name] if name in found else keep(name) for name in ordered}
    return Log(file, {name: topic for name, topic in kept.items() if topic is not None}, reader)


def _is_protobuf(channel: Channel, schema: Schema) -> bool:
    return bool(channel.message_encoding == "protobuf" and schema.encoding == "protobuf")


def _units(metadata: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    try:
        return {name: (str(unit), str(meaning)) for name, (unit, meaning) in json.loads(metadata["units"]).items()}
    except (KeyError, ValueError, TypeError, AttributeError):
        return {}  # a channel that is not ours


def _doubles(rows: Array, start: int, width: int, *, vector: bool) -> Array:
    count = width if vector else 1
    values = np.ascontiguousarray(rows[:, start : start + 8 * count]).view("<f8").astype(np.float64, copy=False)
    return values.reshape(len(rows), count) if vector else values.reshape(len(rows))


def _read(make: Callable[[], Any], messages: Iterable[bytes]) -> dict[str, Array]:
    """Every field of messages of any layout; fields of messages within have names with dots."""
    message = make()
    columns = list(_columns(message.DESCRIPTOR, (), ()))
    values: list[list[Any]] = [[] for _ in columns]
    takers = [(taken.append, get) for taken, (_, get, _) in zip(values, columns, strict=True)]
    for data in messages:
        message = make()
        message.ParseFromString(data)
        for take, get in takers:
            take(get(message))
    return {name: _array(taken, kind) for taken, (name, _, kind) in zip(values, columns, strict=True)}


_Getter = Callable[[Any], Any]
_INTEGERS = {
    getattr(FieldDescriptor, f"TYPE_{name}")
    for name in ("INT32", "INT64", "UINT32", "SINT32", "SINT64", "FIXED32", "SFIXED32", "SFIXED64", "ENUM")
}
_NUMBERS = {FieldDescriptor.TYPE_DOUBLE: np.float64, FieldDescriptor.TYPE_FLOAT: np.float64}
_BOOL = FieldDescriptor.TYPE_BOOL


def _columns(
    descriptor: Descriptor, above: tuple[str, ...], inside: tuple[str, ...]
) -> Iterator[tuple[str, _Getter, type[Any]]]:
    """(name, how to get it, what it is an array of) of every leaf of a message type."""
    for field in descriptor.fields:
        path = (*above, field.name)
        name = ".".join(path)
        kind = field.message_type
        if kind is None:
            dtype = np.int64 if field.type in _INTEGERS else np.bool_ if field.type == _BOOL else object
            dtype = _NUMBERS.get(field.type, dtype)
            yield name, _getter(path, tuple if field.is_repeated else None), dtype
        elif field.is_repeated or kind.full_name in inside:
            yield name, _getter(path, list if field.is_repeated else None), object
        elif kind.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
            yield name, _getter(path, _seconds), np.float64
        elif all(part.type == FieldDescriptor.TYPE_DOUBLE and not part.is_repeated for part in kind.fields):
            yield name, _getter(path, _vector([part.name for part in kind.fields])), np.float64
        else:
            yield from _columns(kind, path, (*inside, descriptor.full_name))


def _getter(path: tuple[str, ...], then: _Getter | None) -> _Getter:
    def get(message: Any) -> Any:
        for name in path:
            message = getattr(message, name)
        return message if then is None else then(message)

    return get


def _seconds(stamp: Any) -> float:
    return float((stamp.seconds * 1_000_000_000 + stamp.nanos) / 1e9)


def _vector(names: list[str]) -> _Getter:
    return lambda message: tuple(getattr(message, name) for name in names)


def _array(values: list[Any], kind: type[Any]) -> Array:
    if kind is object or len({len(v) if isinstance(v, tuple) else -1 for v in values}) > 1:
        return _objects(values)
    return np.array(values, kind)


def _objects(values: Iterable[Any]) -> Array:
    listed = list(values)
    found = np.empty(len(listed), object)
    found[:] = listed
    return found
