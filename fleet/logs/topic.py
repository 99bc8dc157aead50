"""One topic of a log: its messages as bytes of the file, and as numpy columns once a field is used."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property

import numpy as np
from mcap.records import Channel, Schema

from fleet.logs.columns import Columnizer, Columns, cost, extremes, joined
from fleet.logs.decoder import field_meanings
from fleet.mcap.other import MadeColumns, columns_of
from fleet.mcap.reader import LogReadError
from fleet.mcap.records import Array, Block
from netem.parsing import nearest

STEP = 8 << 20  # bytes that are decoded at once
_FOR_USERS = ("name", "schema", "fields", "units", "meanings", "t", "log_ns", "publish_ns", "sequence")


class LogKeyError(LogReadError, KeyError):
    """The log has no such topic, or the topic no such field."""

    __str__ = LogReadError.__str__  # KeyError's would put it in quotes


class TooLargeError(LogReadError):
    """A topic is too large to be held; the text says what to do."""


class Topic:
    """The messages of one topic in the order of the file: the times `t` [s] and one array per field.

    A field is an attribute (`topic.x`) and an item (`topic["x"]`, also where the class has an attribute of that name).
    Numbers have the shape (samples,), or (samples, width) for a vector, and the unit that `units` states; text and
    bytes are arrays of objects. `len(topic)` is the number of samples.

    Example:
        >>> state = log["uuv/1/state"]
        >>> state.units["psi"]
        'rad'
        >>> numpy.interp(12.5, state.t, state.z)  # depth at t = 12.5 s [m]

    Attributes:
        name: such as `uuv/1/state`.
        schema: name of the message type.
        size: bytes of all its messages in the log.
        last_ns: the latest log time of a message [ns]; -1 without any.
        step_ns: time between the samples of a thinned topic [ns]; 0: all samples are there.
        most_held: bytes that it may take in memory.

    Raises:
        LogReadError: from every access to data, if the messages cannot be decoded or are too many to be held.
    """

    def __init__(
        self, name: str, channel: Channel, schema: Schema | None, fetch: Callable[[Topic], None], most_held: int
    ) -> None:
        self.name = name
        self.fetch: Callable[[Topic], None] = fetch  # reads what is not held
        self.most_held = most_held
        self.schema = schema.name if schema is not None else ""
        self.size = 0
        self.last_ns = -1
        self.step_ns = 0
        self._count = 0
        protobuf = schema is not None and channel.message_encoding == schema.encoding == "protobuf"
        self._declared = schema if protobuf else None
        self._foreign = None if protobuf or schema is None else (channel.message_encoding, schema)
        self._declarations = field_meanings(channel)
        self.fields_kept: frozenset[str] | None = None  # None: all
        self._columnizer: Columnizer | MadeColumns | None = None
        self.drop()

    def drop(self) -> None:
        """Hold no message any more."""
        self._held = False
        self._data = bytearray()
        self._lengths = array("I")
        self._log_ns, self._publish_ns, self._numbers = array("Q"), array("Q"), array("Q")
        self._parts: list[Columns] = []
        self._cost = 0  # bytes that the parts take
        self._columns: Columns | None = None
        self.__dict__.pop("t", None)

    def refuse(self) -> None:
        """Hold no message; a later access raises `TooLargeError`."""
        self.drop()
        self.fetch = _refuse

    def count(self, messages: int, size: int, last_ns: int) -> None:
        """Count messages that are not held.

        Args:
            messages: their number.
            size: bytes of all of them.
            last_ns: the latest log time of one [ns].
        """
        self._count += messages
        self.size += size
        self.last_ns = max(self.last_ns, last_ns)

    def add(self, block: Block) -> None:
        """Hold more messages as bytes; only before a field is used."""
        self._held = True
        self._log_ns.frombytes(block.log_ns.tobytes())
        self._publish_ns.frombytes(block.publish_ns.tobytes())
        self._numbers.frombytes(block.sequence.astype(np.uint64).tobytes())
        self._lengths.frombytes((block.end - block.begin).astype(np.uint32).tobytes())
        self._data += block.payloads()

    @property
    def cost(self) -> int:
        """Bytes of memory that are used now."""
        return len(self._data) + 28 * len(self._numbers) + self._cost

    def compact(self, most: int = 0) -> None:
        """Decode what is held as bytes, because columns take less memory.

        Args:
            most: bytes; if less is held, nothing is decoded yet.

        Raises:
            LogReadError: they cannot be decoded.
        """
        if len(self._data) < most:
            return
        if self._columnizer is None:
            self._columnizer = self.columnizer()
        lengths = np.frombuffer(self._lengths, np.uint32)
        ends = np.cumsum(lengths, dtype=np.int64)
        at = first = 0
        while first < len(lengths) or not self._parts:
            stop = max(first + 1, int(np.searchsorted(ends, at + STEP, "right")))
            behind = int(ends[stop - 1]) if first < len(lengths) else at
            part = self._columnizer(bytes(memoryview(self._data)[at:behind]), lengths[first:stop])
            self._parts.append(part)
            self._cost += cost(part, behind - at)
            if self._cost > self.most_held:
                raise self.too_large()
            at, first = behind, stop
        del lengths
        self._data, self._lengths = bytearray(), array("I")

    def thin(self, buckets: int) -> None:
        """Keep of each of `buckets` spans of time the first and the last sample, and the extremes of each column."""
        # True samples, never means: so a picture shows a peak of one tick.
        self.compact()
        columns = joined(self._parts)
        log_ns = np.array(self._log_ns, np.int64)
        span = int(log_ns.max() - log_ns.min()) + 1
        self.step_ns = max(self.step_ns, -(-span // buckets), 1)
        kept = extremes(log_ns // self.step_ns, columns.values())
        self._parts = [{name: values[kept] for name, values in columns.items()}]
        self._cost = sum(values.nbytes for values in self._parts[0].values())
        for held in (self._log_ns, self._publish_ns, self._numbers):
            some = np.frombuffer(held, np.uint64)[kept].tobytes()
            del held[:]
            held.frombytes(some)

    @property
    def too_many(self) -> bool:
        """Whether it was too large for a picture, even without its payloads."""
        return self.fetch is _refuse

    @property
    def doubles(self) -> bool:
        """Whether every field that is held is a number."""
        return bool(self._parts) and all(v.dtype == np.float64 for part in self._parts for v in part.values())

    def too_large(self) -> TooLargeError:
        """The error of a topic that is too large, with arguments of `open_log` that make it smaller."""
        every = max(2, -(-4 * self.size // self.most_held))
        return TooLargeError(
            f"{self.name} holds {self._count} messages of {self.size / 1e6:.0f} MB, more than is held at once: open "
            f"one of {every} messages, or a part: open_log(path, [{self.name!r}], every={every}) or (..., start=0, "
            f"end={max(0, self.last_ns) / 1e9 / every:.3g}) [s]"
        )

    def __len__(self) -> int:
        return len(self._numbers) if self._held else self._count

    def __repr__(self) -> str:
        units = self.units
        shown = ", ".join(f"{name} [{units[name]}]" if units[name] else name for name in self.fields)
        return f"<{self.name}: {len(self)} samples of {shown}>"

    def __getitem__(self, field: str) -> Array:
        """The samples of a field.

        Args:
            field: its name, such as `psi`.

        Returns:
            An array (samples,), or (samples, width) of a vector, in the unit that `units` states.

        Raises:
            LogKeyError: the topic has no such field; a `KeyError` as well.
        """
        columns = self._decoded
        it_has = f"it has {', '.join(columns) or 'no message'}"
        if not isinstance(field, str):
            raise LogKeyError(
                f"{self.name}: fields have names, got {field!r}; {it_has}; each is an array of its samples, as in "
                f"topic[{next(iter(columns), 't')!r}][0]"
            )
        if field not in columns:
            raise LogKeyError(f"{self.name} has no field {field!r}; {nearest(field, list(columns)) or it_has}")
        return columns[field]

    def __iter__(self) -> Iterator[str]:
        """The names of the fields, as of a dictionary."""
        return iter(self.fields)

    def __getattr__(self, field: str) -> Array:
        if field.startswith("_"):  # pickle, copy and notebooks ask for names of their own
            raise AttributeError(field)
        if field in ("to_pandas", "to_xarray"):
            call = f"log.{field}({self.name!r})"
            raise AttributeError(f"a topic has no {field}: the log makes the table, with {call}")
        try:
            return self[field]
        except LogKeyError as error:
            raise AttributeError(str(error)) from None

    def __contains__(self, field: object) -> bool:
        return field in self._decoded

    def __dir__(self) -> Iterable[str]:
        # The others are for whoever reads a log.
        return [*_FOR_USERS, *self.fields]

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of the fields, in the order of the schema."""
        return tuple(self._decoded)

    @cached_property
    def t(self) -> Array:
        """The log time of each message, (samples,), in s of simulated time.

        Of a packet: when it arrived or was lost.
        """
        return self.log_ns / 1e9

    @property
    def log_ns(self) -> Array:
        """The log time of each message, (samples,), in ns, exact."""
        return self._stored("_log_ns")

    @property
    def publish_ns(self) -> Array:
        """The sending time of each message, (samples,), in ns of simulated time."""
        return self._stored("_publish_ns")

    @property
    def sequence(self) -> Array:
        """The number of each message, (samples,): the tick, or of a packet its number on the link."""
        return self._stored("_numbers")

    def _stored(self, name: str) -> Array:
        self._need()
        return np.array(getattr(self, name), np.uint64).astype(np.int64)

    def _need(self) -> None:
        if not self._held and self._count:
            self.fetch(self)

    def declaration(self, field: str) -> tuple[str, str]:
        """Unit and meaning of a field as the log states them.

        Args:
            field: its name.

        Returns:
            Two texts; "" where the log states none.
        """
        return self._declarations.get(field, ("", ""))

    def columnizer(self) -> Columnizer | MadeColumns:
        """The decoder of its messages.

        Raises:
            LogReadError: the log's schema cannot be used.
        """
        if self._foreign is not None:
            made = columns_of(self.name, *self._foreign, self.fields_kept)
            if made is not None:
                return made
        return Columnizer(self.name, self._declared, self.fields_kept)

    @property
    def units(self) -> dict[str, str]:
        """The unit of each field as the log states it; "" for text, and where the log says nothing."""
        return {name: self.declaration(name)[0] for name in self.fields}

    @property
    def meanings(self) -> dict[str, str]:
        """The meaning of each field, as the log states it."""
        return {name: self.declaration(name)[1] for name in self.fields}

    @property
    def nested(self) -> bool:
        """Whether a message holds lists of messages, which are fields here and have no place in a table."""
        return self.columnizer().nested

    @property
    def _decoded(self) -> Columns:
        if self._columns is None:
            self._need()
            self.compact()
            self._columns = joined(self._parts)
            self._parts = []
        return self._columns


def _refuse(topic: Topic) -> None:
    raise topic.too_large()
