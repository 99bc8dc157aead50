"""Where the messages of a chunk of an MCAP file are: its message indexes, and its entry in the file's summary."""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

_INDEX = Struct("<BQHI").pack  # opcode, length of the rest, channel, length of the entries
_CHUNK = Struct("<BQQQQQI").pack  # opcode, length of the rest, times, place and length of the chunk, length of offsets
_SIZES = Struct("<QI4sQQ").pack  # length of the indexes, name of the compression, sizes
_ENTRY = 16  # bytes: log time, place
_OFFSET = np.dtype([("channel", "<u2"), ("offset", "<u8")])


class MessageIndexes(NamedTuple):
    """The message indexes of one chunk, a record for each channel, in the order of the channels' first messages."""

    data: bytes
    offsets: list[int]  # where in `data` each index begins
    counts: dict[int, int]  # channel -> messages
    first_ns: int  # the earliest log time
    last_ns: int  # and the latest

    def chunk_index(self, place: int, length: int, compressed: int, uncompressed: int) -> bytes:
        """The chunk's record in the summary of the file.

        Args:
            place: where in the file the chunk begins; the indexes follow it.
            length: of the chunk [bytes]; then that of its messages as they are in the file, and as they were.
        """
        offsets = np.empty(len(self.counts), dtype=_OFFSET)
        offsets["channel"] = list(self.counts)
        offsets["offset"] = np.array(self.offsets, dtype=np.uint64) + np.uint64(place + length)
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
        """The indexes of all that were added, at least one."""
        single = np.array(self.single, dtype=np.uint64).reshape(-1, 3)
        lengths = [len(part) for part in self._channels]
        channels = np.concatenate([single[:, 0], *self._channels]).astype(np.int64)
        times = np.concatenate([single[:, 1], np.repeat(np.array(self._times, dtype=np.uint64), lengths)])
        places = np.concatenate([single[:, 2].astype(np.int64), *self._places])
        order = (channels << 40 | places).argsort()  # by channel, then by place
        channels = channels[order]
        entries = np.empty((len(order), 2), dtype="<u8")
        entries[:, 0], entries[:, 1] = times[order], places[order]
        begins = np.flatnonzero(np.diff(channels, prepend=-1))
        ends = np.append(begins[1:], len(order))
        groups = np.column_stack((channels[begins], begins, ends))[entries[begins, 1].argsort()]
        packed, data = entries.tobytes(), bytearray()
        offsets: list[int] = []
        counts: dict[int, int] = {}
        for channel, begin, end in groups.tolist():
            offsets.append(len(data))
            counts[channel] = end - begin
            size = _ENTRY * (end - begin)
            data += _INDEX(int(Opcode.MESSAGE_INDEX), 6 + size, channel, size)
            data += packed[_ENTRY * begin : _ENTRY * end]
        return MessageIndexes(bytes(data), offsets, counts, int(times.min()), int(times.max()))
