"""How far two logs are apart, signal by signal: messages are paired, numbers subtracted, the rest counted.

Messages of a topic are paired by sequence number (a tick, or a packet's number) and, for packets, by copy: a packet
that one run delivers later than the other is the same packet. Both logs are read side by side, in order of time, so
only messages that wait for their partner are held.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice, zip_longest
from math import inf, isfinite, isnan
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from fleet.logs.decoder import Decoder, FieldValue
from fleet.logs.reader import LogReader, Record
from fleet.logs.records import Block
from fleet.logs.schemas import FROM, FROM_TICK, OLD_START, START

# --- first difference of two logs: the first message that is not the same in both, field by field


_MOST_BYTES = 24  # of a payload, shown
Plain = str | int | float | bool | None


@dataclass(frozen=True, slots=True)
class Side:
    """One log's side of the first difference."""

    name: str
    record: Record | None  # None: the log has ended
    values: list[FieldValue]
    tick_ns: int
    why: str = ""  # the log has ended

    def __str__(self) -> str:
        if self.record is None:
            return f"the log ends here{f' ({self.why})' if self.why else ''}"
        topic, at, publish_ns, sequence, _ = self.record
        tick = f"tick {at / self.tick_ns:g}, " if self.tick_ns else ""
        return f"{topic}, {tick}t = {at / 1e9:g} s, sent {publish_ns} ns, seq {sequence}"


class MessageRow(Struct, frozen=True):
    """One message of a log."""

    topic: str
    at_s: float
    sent_s: float
    sequence: Annotated[int, Meta(description="Tick, or packet.")]


class FieldRow(Struct, frozen=True):
    """One field of a message that is not the same; bytes in hexadecimal."""

    field: str
    unit: str
    a: Annotated[Plain, Meta(description="First log, or as recorded.")]
    b: Annotated[Plain, Meta(description="Second log, or of the re-run.")]


class Difference(Struct, frozen=True):
    """The first message that differs."""

    number: int
    a: Annotated[MessageRow | None, Meta(description="First log, or as recorded; null: it has ended.")]
    b: Annotated[MessageRow | None, Meta(description="Second log, or of the re-run; null: it has ended.")]
    fields: list[FieldRow]
    words: str

    def __str__(self) -> str:
        return self.words


def difference(number: int, a: Side, b: Side) -> Difference:
    """Two messages that are not the same; `number` counts from 0."""
    if a.record is None or b.record is None or a.record[:4] != b.record[:4]:
        words = "\n".join([f"message {number}", *_all_of(a), *_all_of(b)])
        return Difference(number, _message(a), _message(b), [], words)
    pairs = list(zip_longest(a.values, b.values))
    apart = [pair for pair in pairs if not same(*pair)]
    lines: list[tuple[str, ...]] = [("field", a.name, b.name, "|a - b|", "unit")]
    fields = []
    for one, other in apart:
        path, _, unit = one or other
        fields.append(FieldRow(path, unit, _plain(one), _plain(other)))
        lines.append((path, _shown(one), _shown(other), _gap(one, other), unit))
    words = f"message {number}: {a}\n"
    if apart:
        alike = len(pairs) - len(apart)
        tail = [f"  ({alike} other field{'s' * (alike != 1)} the same)"] if alike else []
        words += "\n".join([*(f"  {line}" for line in _table(lines)), *tail])
    else:  # the same values, written in another way
        words += f"  {a.name}: {_bytes(a.record.data)}\n  {b.name}: {_bytes(b.record.data)}"
    return Difference(number, _message(a), _message(b), fields, words)


def _all_of(side: Side) -> Iterator[str]:
    yield f"  {side.name}: {side}"
    for value in side.values:
        yield f"    {value.path} = {_shown(value)} {value.unit}".rstrip()


def _message(side: Side) -> MessageRow | None:
    record = side.record
    return record and MessageRow(record.topic, record.log_ns / 1e9, record.publish_ns / 1e9, record.sequence)


def _plain(value: FieldValue | None) -> Plain:
    if value is None:
        return None
    found: Plain = value.value.hex() if isinstance(value.value, bytes) else value.value
    return found


def side(name: str, reader: LogReader, record: Record | None) -> Side:
    tick_ns = tick_length(reader)
    if record is None:
        return Side(name, None, [], tick_ns, reader.missing)
    return Side(name, record, Decoder(reader)(record), tick_ns)


def besides_messages(a: LogReader, b: LogReader) -> list[str]:
    """Further differences of two logs: attachments, metadata and the declarations of topics. Where only one of the runs
    goes on from another, that it does so is no difference.
    """
    start: set[str] = {START, OLD_START, FROM, FROM_TICK, "without memory"} if begin_ns(a) != begin_ns(b) else set()
    names = sorted((a.attachments.keys() | b.attachments.keys()) - start)
    found = [f"attachment {name}" for name in names if a.attachments.get(name) != b.attachments.get(name)]
    for name in sorted(a.metadata.keys() | b.metadata.keys()):
        left, right = a.metadata.get(name, {}), b.metadata.get(name, {})
        keys = [key for key in sorted((left.keys() | right.keys()) - start) if left.get(key) != right.get(key)]
        found += [f"metadata {name}: {key} {left.get(key)} and {right.get(key)}" for key in keys]
    topics = {topic for topic, _ in _declared(a).items() ^ _declared(b).items()}
    return [*found, *(f"the declaration of {topic}" for topic in sorted(topics))]


def tick_length(reader: LogReader) -> int:
    """Ts [ns] of a log as far as it was read; 0 if it states none."""
    return _stated(reader, "tick_ns")


def begin_ns(reader: LogReader) -> int:
    """When the run of a log begins, from the part that was read; above 0 if it continues another."""
    return min(_stated(reader, FROM_TICK) * tick_length(reader), 2**63 - 1)


def _stated(reader: LogReader, key: str) -> int:
    text = reader.metadata.get("run", {}).get(key, "0")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else 0


def _declared(reader: LogReader) -> dict[str, tuple[Any, ...]]:
    found: dict[str, tuple[Any, ...]] = {}
    for channel in reader.channels.values():
        schema = reader.schemas.get(channel.schema_id)
        known = (schema.name, schema.encoding, schema.data) if schema is not None else ()
        found[channel.topic] = (*known, channel.message_encoding, tuple(sorted(channel.metadata.items())))
    return found


def same(a: FieldValue | None, b: FieldValue | None) -> bool:
    """Whether a field is there in both messages with the same value; what is no number is the same as another one."""
    if a is None or b is None:
        return False
    return bool(a.value == b.value or (a.value != a.value and b.value != b.value))


def _shown(value: FieldValue | None) -> str:
    if value is None:
        return "-"
    return _bytes(value.value) if isinstance(value.value, bytes) else repr(value.value)


def _bytes(data: bytes) -> str:
    more = f".. ({len(data)} bytes)" if len(data) > _MOST_BYTES else ""
    return data[:_MOST_BYTES].hex() + more


def _gap(a: FieldValue | None, b: FieldValue | None) -> str:
    if a is None or b is None:
        return ""
    if isinstance(a.value, bytes) and isinstance(b.value, bytes):
        place = next((n for n, (x, y) in enumerate(zip(a.value, b.value, strict=False)) if x != y), None)
        return "length" if place is None else f"byte {place}"
    finite = all(isinstance(one.value, int | float) and isfinite(one.value) for one in (a, b))
    return f"{abs(a.value - b.value):.3g}" if finite else ""


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


MOST_WAITING_BYTES = 64 << 20  # of unmatched messages that are held, per log
_STEP = 4096  # messages that are compared at once
MOST_WAITING = 50_000  # messages of one log without their other half; beyond that the oldest count as missing
_NUMBERS = re.compile(r"(?<=/)\d+(-\d+)?")
Key = tuple[str, int, int]  # of a key more than one: faults of one tick


@dataclass(slots=True)
class Deviation:
    """The greatest |a - b| of one signal."""

    value: float
    at_ns: int
    unit: str
    differing: int = 0  # messages in which it is not the same


@dataclass(slots=True)
class LogComparison:
    """The agreements and differences of two logs."""

    begin_ns: int = 0  # what was before is not compared: one of the runs goes on from another and begins here
    first: Difference | None = None
    same: int = 0  # messages, bit for bit
    paired: int = 0  # that are there in both, but differ
    signals: dict[str, Deviation] = field(default_factory=dict)  # topic.field -> numbers that differ
    others: Counter[str] = field(default_factory=Counter)  # topic.field -> differing texts, flags, bytes
    only_a: Counter[str] = field(default_factory=Counter)  # topic -> messages
    only_b: Counter[str] = field(default_factory=Counter)

    def within(self, tolerance: float) -> bool:
        """Whether nothing is missing and no number is further apart. Payloads are bytes that hold such numbers and
        are not judged by themselves."""
        if self.only_a or self.only_b or any(not name.endswith(".payload") for name in self.others):
            return False
        return all(deviation.value <= tolerance for deviation in self.signals.values())


def compare(a: LogReader, b: LogReader) -> LogComparison:
    """Compare two logs to their ends; where one of the runs begins later, from there on. Raises LogReadError if one of
    them is no log.
    """
    found = LogComparison()
    readers = a, b
    decoders = Decoder(a), Decoder(b)
    streams = _Stream(a), _Stream(b)
    begins = [begin_ns(reader) for reader in readers]
    if begins[0] != begins[1]:
        found.begin_ns = max(begins)
        for stream in streams:
            stream.begin(found.begin_ns)
    waiting = _Waiting(), _Waiting()
    number = 0
    while True:
        if alike := streams[0].alike(streams[1]):
            found.same += alike
            number += alike
        heads = [stream.head() for stream in streams]
        if heads[0] is None and heads[1] is None:
            break
        if heads[0] == heads[1]:
            found.same += 1
            turn: tuple[int, ...] = (0, 1)
        else:
            if found.first is None:
                sides = [side("ab"[k], readers[k], heads[k]) for k in (0, 1)]
                found.first = difference(number, sides[0], sides[1])
            # The one that is behind in time catches up, so that few messages wait.
            times = [inf if head is None else head.log_ns for head in heads]
            turn = (0, 1) if times[0] == times[1] else (0,) if times[0] < times[1] else (1,)
            for k in turn:
                record = heads[k]
                assert record is not None
                _meet(found, decoders, waiting, k, record)
        for k in turn:
            streams[k].step()
        number += 1
    for k, only in enumerate((found.only_a, found.only_b)):
        only.update(record.topic for records in waiting[k].records.values() for record in records)
    return found


class _Stream:
    """The messages of one log, one by one, or many of them at once where both logs hold the same."""

    def __init__(self, reader: LogReader) -> None:
        self._reader = reader
        self._blocks = reader.blocks()
        self._block: Block | None = next(self._blocks, None)  # with it, what stands before the messages was read
        self._at = 0
        self._slow = 0  # messages that are still to be compared one by one
        self._records: list[Record] = []  # of those, the next ones, in reverse
        self._topics: dict[int, str] = {}

    def begin(self, at_ns: int) -> None:
        """Skip the messages of times before this; to be called before all else."""
        blocks = self._blocks if self._block is None else chain([self._block], self._blocks)
        self._blocks = (kept for block in blocks if len(kept := block.take(block.log_ns >= at_ns)))
        self._block = next(self._blocks, None)

    def head(self) -> Record | None:
        if not self._records and self._block is not None:
            channels = self._reader.channels
            some = self._block.take(np.arange(self._at, min(self._at + _STEP, len(self._block))))
            self._records = [
                Record(channels[channel].topic, log_ns, publish_ns, sequence, data)
                for channel, sequence, log_ns, publish_ns, data in some.messages()
            ][::-1]
        return self._records[-1] if self._records else None

    def step(self) -> None:
        self._records.pop()
        self._slow -= 1
        self._skip(1)

    def _skip(self, count: int) -> None:
        self._at += count
        while self._block is not None and self._at >= len(self._block):
            self._block, self._at = next(self._blocks, None), 0

    def alike(self, other: _Stream) -> int:
        """Go on behind messages that are the same in both; how many they were."""
        skipped = 0
        while self._slow <= 0 and other._slow <= 0 and not self._records and not other._records:
            if self._block is None or other._block is None:
                break
            count = min(len(self._block) - self._at, len(other._block) - other._at, _STEP)
            mine, theirs = (s._block.take(np.arange(s._at, s._at + count)) for s in (self, other) if s._block)
            if not _equal(self._reader, mine, other._reader, theirs):
                self._slow = other._slow = count
                break
            skipped += count
            self._skip(count)
            other._skip(count)
        return skipped


def _equal(a: LogReader, mine: Block, b: LogReader, theirs: Block) -> bool:
    columns = ("channel", "sequence", "log_ns", "publish_ns")
    if any(not np.array_equal(getattr(mine, name), getattr(theirs, name)) for name in columns):
        return False
    if any(a.channels[n].topic != b.channels[n].topic for n in np.unique(mine.channel).tolist()):
        return False
    same_lengths = np.array_equal(mine.end - mine.begin, theirs.end - theirs.begin)
    return same_lengths and mine.payloads() == theirs.payloads()


class _Waiting:
    """Messages of one log whose other half did not come yet."""

    def __init__(self) -> None:
        self.records: dict[Key, list[Record]] = {}
        self._bytes = 0

    def add(self, key: Key, record: Record) -> Iterator[tuple[str, int]]:
        """Keep a message; gives (topic, how many) of the oldest ones if there are too many now."""
        self.records.setdefault(key, []).append(record)
        self._bytes += len(record.data)
        while len(self.records) > MOST_WAITING or self._bytes > MOST_WAITING_BYTES:
            for old in list(islice(self.records, max(1, len(self.records) // 2))):
                gone = self.records.pop(old)
                self._bytes -= sum(len(record.data) for record in gone)
                yield old[0], len(gone)

    def take(self, key: Key) -> Record | None:
        kept = self.records.get(key)
        if kept is None:
            return None
        record = kept.pop(0)
        self._bytes -= len(record.data)
        if not kept:
            del self.records[key]
        return record


def _meet(
    found: LogComparison, decoders: tuple[Decoder, Decoder], waiting: tuple[_Waiting, _Waiting], k: int, record: Record
) -> None:
    key = _key(decoders[k], record)
    other = waiting[1 - k].take(key)
    if other is None:
        for topic, count in waiting[k].add(key, record):
            (found.only_a, found.only_b)[k][topic] += count
        return
    left, right = (record, other) if k == 0 else (other, record)
    if left == right:
        found.same += 1
        return
    found.paired += 1
    values = decoders[0](left), decoders[1](right)
    _subtract(found, left, _header(left) + values[0], _header(right) + values[1])


def _key(decoder: Decoder, record: Record) -> Key:
    if not record.topic.startswith("link/"):
        return record.topic, record.sequence, 0
    message = decoder.message(record)
    return record.topic, record.sequence, getattr(message, "copy", 0)


def _header(record: Record) -> list[FieldValue]:
    return [FieldValue("log_time", record.log_ns / 1e9, "s"), FieldValue("publish_time", record.publish_ns / 1e9, "s")]


def _subtract(found: LogComparison, record: Record, left: list[FieldValue], right: list[FieldValue]) -> None:
    ours = {value.path: value for value in left}
    theirs = {value.path: value for value in right}
    for path in [*ours, *(path for path in theirs if path not in ours)]:
        a, b = ours.get(path), theirs.get(path)
        name = f"{record.topic}.{path}"
        if a is None or b is None or not (_number(a.value) and _number(b.value)):
            if a is None or b is None or a.value != b.value:
                found.others[name] += 1
            continue
        apart = _apart(a.value, b.value)
        if apart == 0.0:
            continue
        known = found.signals.setdefault(name, Deviation(0.0, record.log_ns, a.unit))
        known.differing += 1
        if apart > known.value:
            known.value, known.at_ns = apart, record.log_ns


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _apart(a: float, b: float) -> float:
    """|a - b|; no distance between two NaNs or equal infinities, an infinite one to a single of them."""
    if a == b or (isnan(a) and isnan(b)):
        return 0.0
    apart = abs(a - b)
    return inf if isnan(apart) else apart


def rows(found: LogComparison, most: int | None = None) -> Iterator[tuple[str, str, str, str, str]]:
    """(signal, greatest |a - b|, unit, at, messages that differ), the greatest differences first."""
    ordered = sorted(found.signals.items(), key=lambda item: (-item[1].value, item[0]))
    for name, deviation in ordered[:most]:
        yield name, f"{deviation.value:.3g}", deviation.unit, f"{deviation.at_ns / 1e9:g} s", str(deviation.differing)


def _alike(counts: Counter[str]) -> list[tuple[str, int]]:
    total: Counter[str] = Counter()
    for name, count in counts.items():
        total[_NUMBERS.sub("*", name)] += count
    return sorted(total.items())


def deviation_lines(found: LogComparison, most: int | None) -> Iterator[str]:
    """The differences, in words and as a table of signals."""
    yield f"{found.same} messages are the same, {found.paired} differ"
    for name, only in (("a", found.only_a), ("b", found.only_b)):
        for topic, count in _alike(only):
            yield f"only in {name}: {count} of {topic}"
    for path, count in _alike(found.others):
        yield f"not the same, and no number: {path} in {count} messages"
    cells = [("signal", "max |a - b|", "unit", "at t", "messages"), *rows(found, most)]
    if len(cells) > 1:
        yield from _table(cells)
    if most is not None and len(found.signals) > most:
        yield f"and {len(found.signals) - most} more signals: --all shows them"
