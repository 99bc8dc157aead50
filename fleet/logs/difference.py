"""The first difference of two logs: the first message that is not the same in both, field by field."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from math import isfinite
from typing import Annotated, Any

from msgspec import Meta, Struct

from fleet.logs.decoder import Decoder, FieldValue
from fleet.logs.schemas import FROM, FROM_TICK, OLD_START, START
from fleet.mcap.reader import LogReader, Record

_NUMBERS = re.compile(r"(?<=/)\d+(-\d+)?")

_MOST_BYTES = 24  # a longer payload is shown by its first bytes
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
        lines.append((path, _show(one), _show(other), _gap(one, other), unit))
    words = f"message {number}: {a}\n"
    if apart:
        alike = len(pairs) - len(apart)
        tail = [f"  ({alike} other field{'s' * (alike != 1)} the same)"] if alike else []
        words += "\n".join([*(f"  {line}" for line in _table(lines)), *tail])
    else:  # the values are equal, and their bytes differ
        words += f"  {a.name}: {_bytes(a.record.data)}\n  {b.name}: {_bytes(b.record.data)}"
    return Difference(number, _message(a), _message(b), fields, words)


def _all_of(side: Side) -> Iterator[str]:
    yield f"  {side.name}: {side}"
    for value in side.values:
        yield f"    {value.path} = {_show(value)} {value.unit}".rstrip()


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
    topics = Counter({topic: 1 for topic, _ in _declarations(a).items() ^ _declarations(b).items()})
    return [*found, *(f"the declaration of {topic}" for topic, _ in alike(topics))]


def alike(counts: Counter[str]) -> list[tuple[str, int]]:
    """The counts of topics that differ by the numbers of vehicles alone, together."""
    total: Counter[str] = Counter()
    for name, count in counts.items():
        total[_NUMBERS.sub("*", name)] += count
    return sorted(total.items())


def tick_length(reader: LogReader) -> int:
    """Ts [ns] of a log as far as it was read; 0 if it states none."""
    return _stated_number(reader, "tick_ns")


def begin_ns(reader: LogReader) -> int:
    """When the run of a log begins, from the part that was read; above 0 if it continues another."""
    return min(_stated_number(reader, FROM_TICK) * tick_length(reader), 2**63 - 1)


def _stated_number(reader: LogReader, key: str) -> int:
    text = reader.metadata.get("run", {}).get(key, "0")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else 0


def _declarations(reader: LogReader) -> dict[str, tuple[Any, ...]]:
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


def _show(value: FieldValue | None) -> str:
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
