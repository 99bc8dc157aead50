"""How far two logs are apart, signal by signal: messages are paired, numbers subtracted, the rest counted.

Messages of a topic are paired by sequence number (a tick, or a packet's number) and, for packets, by copy: a packet
that one run delivers later than the other is the same packet. Both logs are read side by side, in order of time, so
only messages that wait for their partner are held.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, islice
from math import inf, isnan
from typing import Any

import numpy as np

from fleet.logs.decoder import Decoder, FieldValue
from fleet.logs.difference import Difference, _table, alike, begin_ns, difference, side
from fleet.mcap.reader import LogReader, Record
from fleet.mcap.records import Block

MOST_WAITING_BYTES = 64 << 20  # unmatched messages that are held, per log
_STEP = 4096  # messages that are compared at once
MOST_WAITING = 50_000  # messages of one log without their other half; beyond that the oldest count as missing
Key = tuple[str, int, int]  # several messages may have one key: faults of one tick


@dataclass(slots=True)
class Deviation:
    """The greatest |a - b| of one signal."""

    value: float
    at_ns: int
    unit: str
    differing: int = 0  # messages in which the field is not the same


@dataclass(slots=True)
class LogComparison:
    """The agreements and differences of two logs."""

    begin_ns: int = 0  # what was before is not compared: one of the runs goes on from another and begins here
    first: Difference | None = None
    same: int = 0  # messages, bit for bit
    paired: int = 0  # messages that both logs have, with a difference
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
        self._records: list[Record] = []  # the next messages to be compared, in reverse
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
        apart = _distance(a.value, b.value)
        if apart == 0.0:
            continue
        known = found.signals.setdefault(name, Deviation(0.0, record.log_ns, a.unit))
        known.differing += 1
        if apart > known.value:
            known.value, known.at_ns = apart, record.log_ns


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _distance(a: float, b: float) -> float:
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


_FEW = 5  # kinds of differences that are no numbers: of strangers every one differs


def deviation_lines(found: LogComparison, most: int | None) -> Iterator[str]:
    """The differences, in words and as a table of signals."""
    yield f"{found.same} messages are the same, {found.paired} differ"
    for name, only in (("a", found.only_a), ("b", found.only_b)):
        for topic, count in alike(only):
            yield f"only in {name}: {count} of {topic}"
    others = list(alike(found.others))
    for path, count in others[: None if most is None else _FEW]:
        yield f"not the same, and no number: {path} in {count} messages"
    if most is not None and len(others) > _FEW:
        yield f"and {len(others) - _FEW} more that are no numbers: --all shows them"
    cells = [("signal", "max |a - b|", "unit", "at t", "messages"), *rows(found, most)]
    if len(cells) > 1:
        yield from _table(cells)
    if most is not None and len(found.signals) > most:
        yield f"and {len(found.signals) - most} more signals: --all shows them"
