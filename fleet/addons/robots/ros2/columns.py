"""Messages of ROS 2 in a log as columns of numbers and texts, by the types that are known here.

What a bag says of a type is compared with that and never used to decode: `rosbags` makes code of definitions, and a
stranger's would be run. A topic of another type, or of another version of one, stays bytes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Schema

from fleet.addons.robots.ros2.types import DISTRIBUTIONS, RosTypes, types_of
from fleet.errors import FleetError, printable
from fleet.logs.columns import Columns, objects
from fleet.mcap.reader import LogReadError
from fleet.mcap.records import Array

_MOST_TEXT = 1 << 18  # characters of a definition
_MOST_DEEP = 12  # messages within messages
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_SECTION = re.compile(r"^=+[ \t]*\nMSG:[ \t]*(\S+)[ \t]*\n", re.MULTILINE)
_Definition = dict[str, list[tuple[str, str]]]  # by type its fields: type and name


class RosColumn(NamedTuple):
    """One number, vector, text or list of a message."""

    name: str  # with dots for messages within
    kind: str  # `number`, `whole`, `bool`, `vector`, `text` or `list`
    get: Callable[[Any], Any]

    @property
    def is_number(self) -> bool:
        """Whether it is one number."""
        return self.kind in ("number", "whole", "bool")


class RosColumns:
    """Decodes the messages of one topic: see `fleet.logs.columns.Columnizer`."""

    def __init__(self, topic: str, types: RosTypes, name: str, fields: frozenset[str] | None = None) -> None:
        """`fields`: keep only these, as floating point numbers."""
        self._topic, self._types, self._name, self._plain = topic, types, name, fields is not None
        self.columns = [one for one in _columns(types, name, (), 0) if fields is None or one.name in fields]
        self.nested = False  # lists of messages are no columns

    def __call__(self, data: bytes | bytearray, lengths: Array) -> Columns:
        """The columns of messages that stand one behind the other. Raises LogReadError: one is no such message."""
        values: list[list[Any]] = [[] for _ in self.columns]
        view = memoryview(data)
        for begin, end in pairwise([0, *np.cumsum(lengths, dtype=np.int64).tolist()]):
            try:
                message = self._types.decode(self._name, bytes(view[begin:end]))
                for taken, column in zip(values, self.columns, strict=True):
                    taken.append(column.get(message))
            except (ValueError, AttributeError) as error:
                raise LogReadError(f"{printable(self._topic)}: a message is not what its type says: {error}") from None
        return {one.name: self._array(one, taken) for one, taken in zip(self.columns, values, strict=True)}

    def _array(self, column: RosColumn, values: list[Any]) -> Array:
        if self._plain or column.kind in ("number", "vector"):
            return np.array(values, np.float64)
        if column.kind in ("whole", "bool"):
            return np.array(values, np.int64 if column.kind == "whole" else np.bool_)
        return objects(values)


def ros_columns(topic: str, encoding: str, schema: Schema, fields: frozenset[str] | None = None) -> RosColumns | None:
    """What decodes a topic; None: it is none of ROS 2, its type is not known here, or `rosbags` is not installed."""
    if encoding != "cdr" or schema.encoding != "ros2msg" or len(schema.data) > _MOST_TEXT:
        return None
    told = definition_of(schema.name, schema.data.decode("utf-8", "replace"))
    for distribution in reversed(DISTRIBUTIONS):
        try:
            types = types_of(distribution)
        except FleetError:
            return None
        if schema.name in types.store.fielddefs and told == definition_of(schema.name, types.definition(schema.name)):
            return RosColumns(topic, types, schema.name, fields)
    return None


def definition_of(name: str, text: str) -> _Definition:
    """The fields of a type and of those that it consists of, without words, constants and defaults."""
    parts = _SECTION.split(text.replace("\r\n", "\n"))
    sections = {_full(name, ""): parts[0]} | {_full(n, ""): t for n, t in zip(parts[1::2], parts[2::2], strict=True)}
    found: _Definition = {}
    for kind, section in sections.items():
        package = kind.partition("/")[0]
        fields = []
        for line in section.splitlines():
            words = line.partition("#")[0].split()
            if len(words) >= 2 and "=" not in words[1] and words[2:3] != ["="]:
                fields.append((_full(words[0], package), words[1]))
        found[kind] = fields
    return found


_SHORT = {"Header": "std_msgs/Header", "time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}
_BASE = re.compile(r"(bool|byte|char|w?string|u?int(8|16|32|64)|float(32|64))(<=\d+)?$")


def _full(kind: str, package: str) -> str:
    """`geometry_msgs/Point[]` of `Point[]`, of `geometry_msgs/msg/Point[]`, and of itself."""
    name, bracket, rest = kind.partition("[")
    if _BASE.match(name):
        return kind
    name = {
        "Header": "std_msgs/Header",
        "time": "builtin_interfaces/Time",
        "duration": "builtin_interfaces/Duration",
    }.get(name, name)
    first, *others = name.split("/")
    return (f"{first}/{others[-1]}" if others else f"{package}/{first}") + bracket + rest


def _columns(types: RosTypes, name: str, above: tuple[str, ...], deep: int) -> Iterator[RosColumn]:
    from rosbags.interfaces import Nodetype

    for field, (node, detail) in types.store.fielddefs[name][1]:
        path = (*above, field)
        get, called = attrgetter(".".join(path)), ".".join(path)
        if node == Nodetype.NAME and detail in _TIMES:
            yield RosColumn(called, "number", _seconds(get))
        elif node == Nodetype.NAME:
            if deep < _MOST_DEEP:
                yield from _columns(types, str(detail), path, deep + 1)
        elif node == Nodetype.BASE:
            yield RosColumn(called, _kind(str(detail[0])), get)
        elif detail[0][0] == Nodetype.BASE and _kind(str(detail[0][1][0])) != "text":
            fixed = node == Nodetype.ARRAY
            yield RosColumn(called, "vector" if fixed else "list", get if fixed else _list_reader(get))


def _kind(base: str) -> str:
    if "string" in base:
        return "text"
    return "bool" if base == "bool" else "number" if base.startswith("float") else "whole"


def _seconds(get: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def seconds(message: Any) -> float:
        stamp = get(message)
        return (int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)) / 1e9

    return seconds


def _list_reader(get: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def listed(message: Any) -> Any:
        values = get(message)
        return values.tobytes() if values.dtype == np.uint8 else values  # as of a picture

    return listed
