"""Random access to the messages of a log by their number, in the order of their log times. It is not held in memory.

One pass over the log checks it and divides it into pieces (a chunk, or many small ones). It notes the place of each
piece, its number of messages by channel, and its first time. A piece is unpacked again when one of its messages is
wanted. If messages are out of order, a second pass notes the time and place of each, and this log has other pieces than
the file. It ends before the first place that cannot be read, and `missing` says what is missing.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.records import Channel

from fleet.mcap.reader import LogReader, LogReadError, OnProgress, open_file
from fleet.mcap.records import Array, Block, renumbered, together
from fleet.mcap.salvage import Salvage

_STRETCH = 1 << 20  # bytes unpacked, at least, but at the end
_LATEST = (1 << 64) - 1  # ns
_CHOSEN = 4  # stretches of which a track knows what is chosen
_EACH = 50  # bytes that a message of a stretch takes beside its record
_HELD = 96 << 20  # bytes that are kept unpacked, beside the last two pieces or stretches


class Entry(NamedTuple):
    """One message; times in ns."""

    channel: Channel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class _Piece(NamedTuple):
    """A part of a file that is unpacked as a whole."""

    file: Path
    offset: int
    first: int  # number of its first message in the order of the file


class SeekableLog:
    """The messages of a log in the order of their log times; those of the same time in the order of the file."""

    def __init__(self, path: Path, on_progress: OnProgress = lambda _: None) -> None:
        """Read it through. Raises LogReadError if the file cannot be opened, is no MCAP file, or has no complete
        message.
        """
        self.path = path
        reader = LogReader(path, on_progress)
        self._pieces: list[_Piece] = []
        self._order: Array | None = None  # numbers in the order of the file; None: that is in the order of time
        self.firsts = array("Q")  # number of the first message of each stretch
        self._dues = array("Q")  # when that is due
        self.counts: list[tuple[Array, Array]] = []  # channels of each stretch, and how many messages
        self._open: OrderedDict[int, Block] = OrderedDict()  # by number of the piece, and below 0 of the stretch
        self._alone: dict[int, Track] = {}  # by channel
        self._numbers = reader.numbers
        total, latest, rising = 0, 0, True
        pending: list[Block] = []
        file = path

        def enter() -> None:
            nonlocal total
            self._pieces.append(_Piece(file, pending[0].offset, total))
            self._enter(total, int(pending[0].log_ns[0]), np.concatenate([block.channel for block in pending]))
            total += sum(map(len, pending))
            pending.clear()

        for block in reader.blocks():
            held = sum({one.offset: len(one.data) for one in pending}.values())
            if pending and (reader.file != file or (block.offset != pending[-1].offset and held >= _STRETCH)):
                enter()
            file = reader.file
            pending.append(block)
            rising = rising and latest <= block.log_ns[0] and bool((block.log_ns[1:] >= block.log_ns[:-1]).all())
            latest = max(latest, int(block.log_ns.max()))
        if pending:
            enter()
        self.missing, self.channels, self.schemas = reader.missing, reader.channels, reader.schemas
        self.metadata, self.profile = reader.metadata, reader.profile
        if not total:
            raise LogReadError(f"{path} holds no message{f': {self.missing}' if self.missing else ''}")
        self._total, self.end_ns = total, latest
        if not rising:
            self._sort(on_progress)

    def _enter(self, first: int, due: int, channel: Array) -> None:
        self.firsts.append(first)
        self._dues.append(due)
        kinds, counts = np.unique(channel, return_counts=True)
        self.counts.append((kinds, counts.astype(np.uint32)))

    def _sort(self, on_progress: OnProgress) -> None:
        """Divide the log into stretches of messages in the order of time, wherever in the file they are."""
        some = [(one.log_ns, one.channel, one.end - one.begin) for one in LogReader(self.path, on_progress).blocks()]
        log_ns, channel, size = (np.concatenate(column) for column in zip(*some, strict=True))
        if len(log_ns) != self._total:
            raise self._changed()
        self._order = order = np.argsort(log_ns, kind="stable")
        del self.firsts[:], self._dues[:], self.counts[:]
        stretch = np.cumsum(size[order] + _EACH) // _STRETCH
        borders = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), self._total]
        for first, end in pairwise(borders):
            self._enter(first, int(log_ns[order[first]]), channel[order[first:end]])

    def __len__(self) -> int:
        return self._total

    def __getitem__(self, number: int) -> Entry:
        """Message `number`, from 0."""
        k, within = self._place(number)
        return next(self.entries(k, np.array([within])))

    def entries(self, k: int, numbers: Array) -> Iterator[Entry]:
        """Messages of stretch `k`, by their numbers there."""
        channels = self.channels
        for message in self.stretch(k).take(numbers).messages():
            yield Entry(channels[message.channel], *message[1:])

    def due(self, number: int) -> int:
        """When message `number` is due [ns]: its log time."""
        k, within = self._place(number)
        return int(self.stretch(k).log_ns[within])

    def last(self, channels: Iterable[int], ns: int) -> Iterator[tuple[int, Entry]]:
        """The last message before a time of each channel that has one by then, with its number."""
        for channel in channels:
            track = self._alone.setdefault(channel, Track(self, (channel,)))
            if count := track.before(ns):
                yield from track.entries(range(count - 1, count))

    def _place(self, number: int) -> tuple[int, int]:
        if not 0 <= number < self._total:
            raise IndexError(number)
        k = bisect_right(self.firsts, number) - 1
        return k, number - self.firsts[k]

    def stretch_before(self, ns: int) -> int:
        """The last stretch with a first message due before a time; -1 if there is none."""
        return bisect_left(self._dues, ns) - 1

    def stretch(self, k: int) -> Block:
        """Stretch `k`, unpacked. Raises LogReadError if the file has changed since it was read through."""
        return self._piece(k) if self._order is None else self._held(-1 - k, self._gathered)

    def _piece(self, k: int) -> Block:
        return self._held(k, self._unpacked)

    def _held(self, key: int, make: Callable[[int], Block]) -> Block:
        if key in self._open:
            self._open.move_to_end(key)
            return self._open[key]
        found = make(key)
        while len(self._open) > 1 and sum(len(one.data) + _EACH * len(one) for one in self._open.values()) > _HELD:
            self._open.popitem(last=False)
        self._open[key] = found
        return found

    def _gathered(self, key: int) -> Block:
        """The messages of a stretch, from all pieces that have some of them."""
        assert self._order is not None
        k = -1 - key
        numbers = self._order[self.firsts[k] : self.firsts[k + 1] if k + 1 < len(self.firsts) else None]
        firsts = np.array([piece.first for piece in self._pieces])
        pieces = np.searchsorted(firsts, numbers, "right") - 1
        where = [np.flatnonzero(pieces == piece) for piece in np.unique(pieces)]
        parts = [self._piece(int(pieces[rows[0]])).take(numbers[rows] - firsts[pieces[rows[0]]]) for rows in where]
        return together([part.alone() for part in parts]).take(np.argsort(np.concatenate(where)))

    def _unpacked(self, k: int) -> Block:
        piece = self._pieces[k]
        wanted = (self._pieces[k + 1].first if k + 1 < len(self._pieces) else self._total) - piece.first
        blocks: list[Block] = []
        found = 0
        with open_file(piece.file) as file:
            for item in Salvage(file, at=piece.offset):
                if isinstance(item, Block):
                    blocks.append(item)
                    found += len(item)
                if found >= wanted:
                    break
        if found < wanted:
            raise self._changed()
        return renumbered(together(blocks).take(np.arange(wanted)), self._numbers[piece.file])

    def _changed(self) -> LogReadError:
        return LogReadError(f"{self.path} has changed: another program wrote to it during reading")


class Track:
    """The messages of some channels of a log, by their numbers among themselves, with the times when they are due."""

    def __init__(self, log: SeekableLog, channels: Collection[int]) -> None:
        self._log = log
        self._channels = np.fromiter(channels, np.uint16, len(channels))
        self._firsts = array("Q")
        total = 0
        for kinds, counts in log.counts:
            self._firsts.append(total)
            total += int(counts[np.isin(kinds, self._channels)].sum())
        self._total = total
        self._chosen: OrderedDict[int, tuple[Array, Array]] = OrderedDict()

    def __len__(self) -> int:
        return self._total

    def __getitem__(self, index: int) -> int:
        """When message `index` is due [ns]."""
        k, within = self._place(index)
        return int(self._of(k)[1][within])

    def entries(self, some: range) -> Iterator[tuple[int, Entry]]:
        """Messages that follow on one another, each with its number in the log."""
        at = some.start
        while at < some.stop:
            k, within = self._place(at)
            numbers = self._of(k)[0][within : within + some.stop - at]
            yield from zip((numbers + self._log.firsts[k]).tolist(), self._log.entries(k, numbers), strict=True)
            at += len(numbers)

    def before(self, ns: int) -> int:
        """How many are due before a time."""
        k = self._log.stretch_before(ns)
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
            stretch = self._log.stretch(k)
            numbers = np.flatnonzero(np.isin(stretch.channel, self._channels))
            self._chosen[k] = numbers, stretch.log_ns[numbers]
            if len(self._chosen) > _CHOSEN:
                self._chosen.popitem(last=False)
        return self._chosen[k]
