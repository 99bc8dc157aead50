"""Messages of one topic as numpy columns, decoded by the schema that the log carries, some at a time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.records import Schema

from fleet.logs.decoder import message_class
from fleet.logs.schemas import head
from fleet.mcap.reader import LogReadError
from fleet.mcap.records import Array
from netem.limits import LOG_MESSAGE

_WORDS = 4096  # different texts of a column that are held once only
_NESTED = 20  # times as large as its bytes is a message that is held as an object, about

Columns = dict[str, Array]


class Columnizer:
    """Decodes the messages of one topic; `schema` None: they are bytes."""

    def __init__(self, name: str, schema: Schema | None, fields: frozenset[str] | None = None) -> None:
        """`fields`: keep only these, of a topic that is not doubles alone. Raises LogReadError if the schema cannot be
        used.
        """
        self._name, self._schema, self._fields = name, schema, fields
        self._make: Callable[[], Any] | None = None
        self._words: dict[str, str] = {}
        if schema is not None:
            try:
                self._make = message_class(schema)
            except (DecodeError, TypeError, KeyError) as error:
                raise LogReadError(f"{name}: the log's schema {schema.name} cannot be used ({error})") from error

    @property
    def nested(self) -> bool:
        """Whether a message holds lists of messages."""
        if self._make is None:
            return False
        return any(lists for _, _, _, lists in _columns(self._make().DESCRIPTOR, (), ()))

    def __call__(self, data: bytes | bytearray, lengths: Array) -> Columns:
        """The columns of messages that stand one behind the other. Raises LogReadError if one is not what the schema
        says, or too large to be decoded.
        """
        if self._make is None:
            return {"data": objects(_split(data, lengths))}
        if len(lengths) and lengths.max() > LOG_MESSAGE.bytes:
            raise LogReadError(
                f"{self._name}: a message of {lengths.max()} bytes, more than the {LOG_MESSAGE.bytes} decoded"
            )
        try:
            quick = self._structured(self._make, data, lengths)
            return self._read(self._make, _split(data, lengths)) if quick is None else quick
        except DecodeError as error:
            assert self._schema is not None
            raise LogReadError(f"{self._name}: a message is not what its schema {self._schema.name} says") from error

    def _structured(self, make: Callable[[], Any], data: bytes | bytearray, lengths: Array) -> Columns | None:
        fields = sorted(make().DESCRIPTOR.fields, key=lambda field: field.number)
        if not len(lengths) or any(field.type != FieldDescriptor.TYPE_DOUBLE for field in fields):
            return None
        first = make()
        first.ParseFromString(bytes(data[: lengths[0]]))
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
        rows = np.frombuffer(data, np.uint8).reshape(-1, size)
        if any((rows[:, at : at + len(tag)] != np.frombuffer(tag, np.uint8)).any() for at, tag in heads):
            return None
        return {
            field.name: _doubles(rows, *places[field.name], vector=field.is_repeated)
            for field in make().DESCRIPTOR.fields
        }

    def _read(self, make: Callable[[], Any], messages: Iterable[bytes]) -> Columns:
        """Every field of messages of any layout; fields of messages within have names with dots."""
        message = make()
        columns = [
            (name, get, kind)
            for name, get, kind, _ in _columns(message.DESCRIPTOR, (), ())
            if self._fields is None or name in self._fields
        ]
        values: list[list[Any]] = [[] for _ in columns]
        takers = [(taken.append, get) for taken, (_, get, _) in zip(values, columns, strict=True)]
        for data in messages:
            message = make()
            message.ParseFromString(data)
            for take, get in takers:
                take(get(message))
        return {
            name: _array(self._once(taken) if kind is object else taken, kind)
            for taken, (name, _, kind) in zip(values, columns, strict=True)
        }

    def _once(self, values: list[Any]) -> list[Any]:
        """The same with equal texts as one object, if they are few."""
        words = self._words
        for k, value in enumerate(values):
            if type(value) is str and (value in words or len(words) < _WORDS):
                values[k] = words.setdefault(value, value)
        return values


_Getter = Callable[[Any], Any]
_INTEGERS = {
    getattr(FieldDescriptor, f"TYPE_{name}")
    for name in ("INT32", "INT64", "UINT32", "SINT32", "SINT64", "FIXED32", "SFIXED32", "SFIXED64", "ENUM")
}
_NUMBERS = {FieldDescriptor.TYPE_DOUBLE: np.float64, FieldDescriptor.TYPE_FLOAT: np.float64}
_BOOL = FieldDescriptor.TYPE_BOOL
_TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")  # a foreign log may mean something else by it


def _columns(
    descriptor: Descriptor, above: tuple[str, ...], inside: tuple[str, ...]
) -> Iterator[tuple[str, _Getter, type[Any], bool]]:
    """(name, how to get it, what it is an array of, whether it is a list of messages) of every leaf of a type."""
    for field in descriptor.fields:
        path = (*above, field.name)
        name = ".".join(path)
        kind = field.message_type
        if kind is None:
            dtype = np.int64 if field.type in _INTEGERS else np.bool_ if field.type == _BOOL else object
            dtype = _NUMBERS.get(field.type, dtype)
            yield name, _getter(path, tuple if field.is_repeated else None), dtype, False
        elif field.is_repeated or kind.full_name in inside:
            yield name, _getter(path, list if field.is_repeated else None), object, field.is_repeated
        elif kind.full_name in _TIMES and {"seconds", "nanos"} <= set(kind.fields_by_name):
            yield name, _getter(path, lambda t: (t.seconds * 1_000_000_000 + t.nanos) / 1e9), np.float64, False
        elif all(part.type == FieldDescriptor.TYPE_DOUBLE and not part.is_repeated for part in kind.fields):
            yield name, _getter(path, _vector([part.name for part in kind.fields])), np.float64, False
        else:
            yield from _columns(kind, path, (*inside, descriptor.full_name))


def _getter(path: tuple[str, ...], then: _Getter | None) -> _Getter:
    get = attrgetter(".".join(path))
    return get if then is None else lambda message: then(get(message))


def _vector(names: list[str]) -> _Getter:
    return lambda message: tuple(getattr(message, name) for name in names)


def _array(values: list[Any], kind: type[Any]) -> Array:
    if kind is object or len({len(v) if isinstance(v, tuple) else -1 for v in values}) > 1:
        return objects(values)
    return np.array(values, kind)


def objects(values: Iterable[Any]) -> Array:
    """An array of objects, also of tuples."""
    listed = list(values)
    found = np.empty(len(listed), object)
    found[:] = listed
    return found


def joined(parts: list[Columns]) -> Columns:
    """Columns of parts one behind the other; takes them out of the parts, so that little is held twice."""
    found: Columns = {}
    for name in list(parts[0]) if parts else []:
        columns = [part.pop(name) for part in parts]
        if len({(column.ndim, column.shape[1:]) for column in columns if len(column)}) > 1:
            columns = [column if column.ndim == 1 else objects(map(tuple, column.tolist())) for column in columns]
        full = [column for column in columns if len(column)]
        found[name] = np.concatenate(full) if len(full) > 1 else (full or columns)[0]
    return found


def extremes(buckets: Array, columns: Iterable[Array]) -> Array:
    """The rows, in order, of the first and the last of each bucket and of the extremes of each column in it."""
    order = np.argsort(buckets, kind="stable")
    ordered = buckets[order]
    starts = np.flatnonzero(np.concatenate(([True], ordered[1:] != ordered[:-1])))
    sizes = np.diff(np.append(starts, len(order)))
    kept = np.zeros(len(order), bool)
    kept[starts] = kept[starts + sizes - 1] = True
    for column in columns:
        for values in column.reshape(len(column), -1).T:
            here = values[order]
            for extreme in (np.fmin, np.fmax):
                reached = np.flatnonzero(here == np.repeat(extreme.reduceat(here, starts), sizes))
                first = np.searchsorted(reached, starts)
                there = first < len(reached)
                places = reached[first[there]]
                kept[places[places < (starts + sizes)[there]]] = True
    return np.sort(order[kept])


def cost(columns: Columns, size: int) -> int:
    """Bytes that the columns of messages take, from the bytes of the messages."""
    total = 0
    for values in columns.values():
        total += values.nbytes
        if values.dtype == object and len(values):
            once = {id(value): value for value in values}.values()
            plain = isinstance(values[0], str | bytes | int | float)
            total += sum(map(sys.getsizeof, once)) if plain else _NESTED * size
    return total


def _split(data: bytes | bytearray, lengths: Array) -> Iterator[bytes]:
    ends = np.cumsum(lengths, dtype=np.int64).tolist()
    view = memoryview(data)
    for begin, end in pairwise([0, *ends]):
        yield bytes(view[begin:end])


def _doubles(rows: Array, start: int, width: int, *, vector: bool) -> Array:
    count = width if vector else 1
    values = np.ascontiguousarray(rows[:, start : start + 8 * count]).view("<f8").astype(np.float64, copy=False)
    return values.reshape(len(rows), count) if vector else values.reshape(len(rows))
