"""Random access to the messages of an MCAP file by their number, without holding the file in memory.

One pass over the file checks it and divides it into stretches (a chunk, or many small ones). It notes the place of each
stretch, its number of messages by channel, and their due times. A stretch is unpacked again when one of its messages is
wanted. The tape ends before the first place that cannot be read, and `missing` says what is missing.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.records import Channel

from fleet.logs.reader import LogReader, LogReadError, Tell, open_file
from fleet.logs.records import Array, Block, together
from fleet.logs.salvage import Salvage

_STRETCH = 1 << 20  # bytes unpacked, at least, but at the end
_LATEST = (1 << 64) - 1  # ns
_CHOSEN = 4  # stretches of which a track knows what is chosen
_EACH = 50  # bytes that a message of a stretch takes beside its record
_HELD = 96 << 20  # bytes of stretches that are kept unpacked, beside the last two


class Entry(NamedTuple):
    """One message; times in ns."""

    channel: Channel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class _Stretch(NamedTuple):
    block: Block
    due: Array  # when each message is due [ns]: never earlier than one before it

    @property
    def size(self) -> int:
        return len(self.block.data) + _EACH * len(self.block)


class Tape:
    """The messages of an MCAP file in the order of the file."""

    def __init__(self, path: Path, tell: Tell = lambda _: None) -> None:
        """Read it through. Raises LogReadError if the file cannot be opened, is no MCAP file, or has no complete
        message.
        """
        self.path = path
        reader = LogReader(path, tell)
        self._offsets = array("Q")  # where each stretch begins
        self.firsts = array("Q")  # number of its first message
        self._dues = array("Q")  # when that is due
        self._floors = array("Q")  # when the message before it is due
        self.counts: list[tuple[Array, Array]] = []  # channels of each stretch, and how many messages
        self._open: OrderedDict[int, _Stretch] = OrderedDict()
        total, latest = 0, 0
        pending: list[Block] = []

        def enter() -> None:
            nonlocal total, latest
            channel = np.concatenate([block.channel for block in pending])
            self._offsets.append(pending[0].offset)
            self.firsts.append(total)
            self._floors.append(latest)
            self._dues.append(max(latest, int(pending[0].log_ns[0])))
            kinds, counts = np.unique(channel, return_counts=True)
            self.counts.append((kinds, counts.astype(np.uint32)))
            total += len(channel)
            latest = max(latest, *(int(block.log_ns.max()) for block in pending))
            pending.clear()

        for block in reader.blocks():
            held = sum({one.offset: len(one.data) for one in pending}.values())
            if pending and block.offset != pending[-1].offset and held >= _STRETCH:
                enter()
            pending.append(block)
        if pending:
            enter()
        self.missing, self.channels, self.schemas = reader.missing, reader.channels, reader.schemas
        self.metadata, self.profile = reader.metadata, reader.profile
        if not total:
            raise LogReadError(f"{path} holds no message{f': {self.missing}' if self.missing else ''}")
        self._total, self.end_ns = total, latest

    def __len__(self) -> int:
        return self._total

    def __getitem__(self, number: int) -> Entry:
        """Message `number`, from 0."""
        k, within = self._place(number)
        return next(self.entries(k, np.array([within])))

    def entries(self, k: int, numbers: Array) -> Iterator[Entry]:
        """Messages of part `k` of the file, by their numbers there."""
        block, channels = self.stretch(k).block, self.channels
        some = block.take(numbers)
        for message in some.messages():
            yield Entry(channels[message.channel], *message[1:])

    def due(self, number: int) -> int:
        """When message `number` is due [ns]: never earlier than one before it."""
        k, within = self._place(number)
        return int(self.stretch(k).due[within])

    def _place(self, number: int) -> tuple[int, int]:
        if not 0 <= number < self._total:
            raise IndexError(number)
        k = bisect_right(self.firsts, number) - 1
        return k, number - self.firsts[k]

    def stretch_before(self, ns: int) -> int:
        """The last part of the file with a first message due before a time; -1 if there is none."""
        return bisect_left(self._dues, ns) - 1

    def stretch(self, k: int) -> _Stretch:
        """Part `k` of the file, unpacked. Raises LogReadError if the file has changed since it was read through."""
        if k in self._open:
            self._open.move_to_end(k)
            return self._open[k]
        end = self.firsts[k + 1] if k + 1 < len(self.firsts) else self._total
        wanted = end - self.firsts[k]
        while len(self._open) > 1 and sum(stretch.size for stretch in self._open.values()) > _HELD:
            self._open.popitem(last=False)
        self._open[k] = found = _unpack(self.path, self._offsets[k], wanted, self._floors[k])
        return found


class Track:
    """The messages of some channels of a tape, by their numbers among themselves, with the times when they are due."""

    def __init__(self, tape: Tape, channels: Collection[int]) -> None:
        self._tape = tape
        self._channels = np.fromiter(channels, np.uint16, len(channels))
        self._firsts = array("Q")
        total = 0
        for kinds, counts in tape.counts:
            self._firsts.append(total)
            total += int(counts[np.isin(kinds, self._channels)].sum())
        self._total = total
        self._chosen: OrderedDict[int, tuple[Array, Array]] = OrderedDict()

    def __len__(self) -> int:
        return self._total

    def __getitem__(self, index: int) -> int:
        """When message `index` is due [ns]; never earlier than one before it on the tape."""
        k, within = self._place(index)
        return int(self._of(k)[1][within])

    def entries(self, some: range) -> Iterator[tuple[int, Entry]]:
        """Messages that follow on one another, each with its number on the tape."""
        at = some.start
        while at < some.stop:
            k, within = self._place(at)
            numbers = self._of(k)[0][within : within + some.stop - at]
            yield from zip((numbers + self._tape.firsts[k]).tolist(), self._tape.entries(k, numbers), strict=True)
            at += len(numbers)

    def before(self, ns: int) -> int:
        """How many are due before a time."""
        k = self._tape.stretch_before(ns)
        if k < 0:
            return 0
        return self._firsts[k] + int(np.searchsorted(self._of(k)[1], np.uint64(min(max(ns, 0), _LATEST))))

    def _place(self, index: int) -> tuple[int, int]:
        if not 0 <= index < self._total:
            raise IndexError(index)
        k = bisect_right(self._firsts, index) - 1
        return k, index - self._firsts[k]

    def _of(self, k: int) -> tuple[Array, Array]:
        """Numbers within a stretch, and due times, of the chosen messages."""
        if k not in self._chosen:
            stretch = self._tape.stretch(k)
            numbers = np.flatnonzero(np.isin(stretch.block.channel, self._channels))
            self._chosen[k] = numbers, stretch.due[numbers]
            if len(self._chosen) > _CHOSEN:
                self._chosen.popitem(last=False)
        return self._chosen[k]


def _unpack(path: Path, offset: int, messages: int, floor: int) -> _Stretch:
    blocks: list[Block] = []
    found = 0
    with open_file(path) as file:
        for item in Salvage(file, at=offset):
            if isinstance(item, Block):
                blocks.append(item)
                found += len(item)
            if found >= messages:
                break
    if found < messages:
        raise LogReadError(f"{path} has changed: another program wrote to it during reading")
    block = together(blocks).take(np.arange(messages))
    # A message earlier than the one before it is due together with it: the order of the file is kept.
    return _Stretch(block, np.maximum(np.maximum.accumulate(block.log_ns), np.uint64(floor)))
