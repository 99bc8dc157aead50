"""How far two logs are apart, signal by signal: messages are paired, numbers subtracted, the rest counted.

Messages of a topic are paired by sequence number (a tick, or a packet's number) and, for packets, by copy: a packet
that one run delivers later than the other is the same packet. Both logs are read side by side, in order of time;
what still waits for its other half is all that is held.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from math import inf, isnan
from typing import Any

from fleet.difference import Difference, side
from fleet.log_values import Decoder, Value
from fleet.reader import LogReader, Record

MOST_WAITING = 50_000  # messages of one log without their other half; beyond that the oldest count as missing
_NUMBERS = re.compile(r"(?<=/)\d+(-\d+)?")
Key = tuple[str, int, int]
Waiting = dict[Key, list[Record]]  # of a key more than one: faults of one tick


@dataclass(slots=True)
class Deviation:
    """The greatest |a - b| of one signal."""

    value: float
    at_ns: int
    unit: str
    differing: int = 0  # messages in which it is not the same


@dataclass(slots=True)
class Comparison:
    """What two logs have in common and what not."""

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


def compare(
    a: LogReader, b: LogReader, names: tuple[str, str] = ("a", "b"), tell: Callable[[float], None] = lambda at_s: None
) -> Comparison:
    """Compare two logs to their ends; `tell` hears how far in sim time [s].

    Raises:
        LogReadError: one of them is no log.
    """
    found = Comparison()
    readers = a, b
    decoders = Decoder(a), Decoder(b)
    streams = iter(a), iter(b)
    waiting: tuple[Waiting, Waiting] = ({}, {})
    heads = [next(stream, None) for stream in streams]
    number = 0
    while heads[0] is not None or heads[1] is not None:
        if heads[0] == heads[1]:
            found.same += 1
            turn: tuple[int, ...] = (0, 1)
        else:
            if found.first is None:
                sides = [side(names[k], readers[k], heads[k]) for k in (0, 1)]
                found.first = Difference(number, sides[0], sides[1])
            # The one that is behind in time catches up, so that few messages wait.
            times = [inf if head is None else head.log_ns for head in heads]
            turn = (0, 1) if times[0] == times[1] else (0,) if times[0] < times[1] else (1,)
            for k in turn:
                record = heads[k]
                assert record is not None
                _meet(found, decoders, waiting, k, record)
        for k in turn:
            heads[k] = next(streams[k], None)
        number += 1
        if not number % 1000:
            tell(max(head.log_ns if head is not None else 0 for head in heads) / 1e9)
    for k, only in enumerate((found.only_a, found.only_b)):
        only.update(record.topic for records in waiting[k].values() for record in records)
    return found


def _meet(
    found: Comparison,
    decoders: tuple[Decoder, Decoder],
    waiting: tuple[Waiting, Waiting],
    k: int,
    record: Record,
) -> None:
    """A message of log k finds its other half, or waits for it."""
    key = _key(decoders[k], record)
    others = waiting[1 - k].get(key)
    if others is None:
        waiting[k].setdefault(key, []).append(record)
        if len(waiting[k]) > MOST_WAITING:
            for old in list(islice(waiting[k], MOST_WAITING // 2)):
                (found.only_a, found.only_b)[k][old[0]] += len(waiting[k].pop(old))
        return
    other = others.pop(0)
    if not others:
        del waiting[1 - k][key]
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


def _header(record: Record) -> list[Value]:
    return [Value("log_time", record.log_ns / 1e9, "s"), Value("publish_time", record.publish_ns / 1e9, "s")]


def _subtract(found: Comparison, record: Record, left: list[Value], right: list[Value]) -> None:
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


def rows(found: Comparison, most: int | None = None) -> Iterator[tuple[str, str, str, str, str]]:
    """(signal, greatest |a - b|, unit, at, messages that differ), those that are furthest apart first."""
    ordered = sorted(found.signals.items(), key=lambda item: (-item[1].value, item[0]))
    for name, deviation in ordered[:most]:
        yield name, f"{deviation.value:.3g}", deviation.unit, f"{deviation.at_ns / 1e9:g} s", str(deviation.differing)


def _alike(counts: Counter[str]) -> list[tuple[str, int]]:
    """The same with all vehicles, and all links, in one."""
    total: Counter[str] = Counter()
    for name, count in counts.items():
        total[_NUMBERS.sub("*", name)] += count
    return sorted(total.items())


def table(found: Comparison, most: int | None) -> Iterator[str]:
    """What is not the same, in words and as a table of signals."""
    yield f"{found.same} messages are the same, {found.paired} differ"
    for name, only in (("a", found.only_a), ("b", found.only_b)):
        for topic, count in _alike(only):
            yield f"only in {name}: {count} of {topic}"
    for path, count in _alike(found.others):
        yield f"not the same, and no number: {path} in {count} messages"
    cells = [("signal", "max |a - b|", "unit", "at t", "messages"), *rows(found, most)]
    if len(cells) > 1:
        widths = [max(len(row[k]) for row in cells) for k in range(5)]
        for row in cells:
            yield "  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip()
    if most is not None and len(found.signals) > most:
        yield f"and {len(found.signals) - most} more signals: --all shows them"
