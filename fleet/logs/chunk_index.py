"""Where the messages of a chunk of an MCAP file are: its message indexes, and its entry in the file's summary."""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

_HEAD = np.dtype([("opcode", "u1"), ("rest", "<u8"), ("channel", "<u2"), ("entries", "<u4")])  # lengths in bytes
_ENTRY = np.dtype([("time", "<u8"), ("place", "<u8")])
_OFFSET = np.dtype([("channel", "<u2"), ("offset", "<u8")])
_CHUNK = Struct("<BQQQQQI").pack  # opcode, length of the rest, times, place and length of the chunk, length of offsets
_SIZES = Struct("<QI4sQQ").pack  # length of the indexes, name of the compression, sizes


class MessageIndexes(NamedTuple):
    """The message indexes of one chunk, a record for each channel, in the order of the channels' first messages."""

    data: bytes
    offsets: NDArray[np.void]  # channels, and where in `data` the index of each begins
    counts: list[tuple[int, int]]  # channels, and how many messages each has
    first_ns: int  # the earliest log time
    last_ns: int  # and the latest

    def chunk_index(self, place: int, length: int, compressed: int, uncompressed: int) -> bytes:
        """The chunk's record in the summary of the file.

        Args:
            place: where in the file the chunk begins; the indexes follow it.
            length: of the chunk [bytes].
            compressed: length of its messages as they are in the file, and `uncompressed` as they were.
        """
        offsets = self.offsets.copy()
        offsets["offset"] += np.uint64(place + length)
        times, map_bytes = (self.first_ns, self.last_ns), offsets.nbytes
        sizes = _SIZES(len(self.data), len(b"zstd"), b"zstd", compressed, uncompressed)
        head = _CHUNK(int(Opcode.CHUNK_INDEX), 36 + map_bytes + len(sizes), *times, place, length, map_bytes)
        return head + offsets.tobytes() + sizes


class ChunkEntries:
    """Channel, log time and place in the chunk of every message, as they come."""

    def __init__(self) -> None:
        self.single: list[int] = []  # channel, log time and place of one message after the other
        self._channels: list[NDArray[np.uint16]] = []
        self._places: list[NDArray[np.int64]] = []
        self._times: list[int] = []

    def __bool__(self) -> bool:
        return bool(self.single or self._times)

    def add(self, at_ns: int, channels: NDArray[np.uint16], places: NDArray[np.int64]) -> None:
        """Add messages that have their log time in common."""
        self._times.append(at_ns)
        self._channels.append(channels)
        self._places.append(places)

    def clear(self) -> None:
        """Forget all of them."""
        for entries in (self.single, self._channels, self._places, self._times):
            entries.clear()

    def indexes(self) -> MessageIndexes:
        """The indexes of all added messages, at least one."""
        single = np.array(self.single, dtype=np.uint64).reshape(-1, 3)
        lengths = [len(part) for part in self._channels]
        channels = np.concatenate([single[:, 0], *self._channels]).astype(np.int64)
        times = np.concatenate([single[:, 1], np.repeat(np.array(self._times, dtype=np.uint64), lengths)])
        places = np.concatenate([single[:, 2].astype(np.int64), *self._places])

        order = (channels << 40 | places).argsort()  # by channel, then by place
        channels, places = channels[order], places[order]
        begins = np.flatnonzero(np.diff(channels, prepend=-1))  # where another channel begins
        counts = np.diff(begins, append=len(order))
        sizes = _HEAD.itemsize + _ENTRY.itemsize * counts
        by_first = places[begins].argsort()
        offsets = np.empty(len(begins), np.int64)  # of the record of each channel
        offsets[by_first] = np.cumsum(sizes[by_first]) - sizes[by_first]

        heads = np.empty(len(begins), _HEAD)
        heads["opcode"], heads["channel"] = int(Opcode.MESSAGE_INDEX), channels[begins]
        heads["entries"] = _ENTRY.itemsize * counts
        heads["rest"] = sizes - 9  # without opcode and length
        entries = np.empty(len(order), _ENTRY)
        entries["time"], entries["place"] = times[order], places
        data = np.empty(int(sizes.sum()), np.uint8)
        _put(data, offsets, heads)
        first = np.repeat(offsets + _HEAD.itemsize - _ENTRY.itemsize * begins, counts)
        _put(data, first + _ENTRY.itemsize * np.arange(len(order)), entries)

        found = np.empty(len(begins), _OFFSET)
        found["channel"], found["offset"] = channels[begins][by_first], offsets[by_first]
        pairs = zip(found["channel"].tolist(), counts[by_first].tolist(), strict=True)
        return MessageIndexes(data.tobytes(), found, [*pairs], int(times.min()), int(times.max()))


def _put(data: NDArray[np.uint8], places: NDArray[np.int64], records: NDArray[np.void]) -> None:
    """Write each record at its place."""
    size = records.dtype.itemsize
    data[places[:, None] + np.arange(size)] = records.view(np.uint8).reshape(-1, size)
