"""The records of an MCAP file, each parsed from its own bytes, and what a chunk unpacks to: never more than a bound."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from struct import Struct
from struct import error as struct_error
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Metadata, Schema

from fleet.errors import FleetError
from netem.limits import LOG_RECORD

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "uuv-fleet"  # in the header of files that this program writes
_SHORT = 1024  # bytes of payloads that are gathered by numpy
HEAD = Struct("<BQ")
CHUNK = Struct("<QQQI")  # first and last time [ns], unpacked size, CRC
MESSAGE = Struct("<HIQQ")
U32, U64 = Struct("<I"), Struct("<Q")
_LENGTH = Struct("<xQ")  # the length of a record stands behind its opcode
_RECORD = np.dtype([
    ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"),
    ("publish_ns", "<u8"),
])  # fmt: skip
BROKEN = (struct_error, ValueError, RuntimeError, zstandard.ZstdError)  # lz4 raises RuntimeError

Array = np.ndarray[Any, np.dtype[Any]]
Record = Schema | Channel | Chunk | Header | Metadata | Attachment | DataEnd


class Message(NamedTuple):
    """One message as it stands in a chunk, times in ns."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Block:
    """Messages that follow on one another in one chunk, or outside chunks, as arrays; times in ns."""

    offset: int  # place of the chunk, or of the first message outside chunks [byte of the file]
    data: bytes  # in which they stand
    channel: Array
    sequence: Array
    log_ns: Array
    publish_ns: Array
    begin: Array  # where each payload begins in `data`
    end: Array

    def __len__(self) -> int:
        return len(self.channel)

    def messages(self) -> Iterator[Message]:
        columns = (self.channel, self.sequence, self.log_ns, self.publish_ns, self.begin, self.end)
        data = self.data
        for channel, sequence, log_ns, publish_ns, begin, end in zip(*(c.tolist() for c in columns), strict=True):
            yield Message(channel, sequence, log_ns, publish_ns, data[begin:end])

    def take(self, which: Array) -> Block:
        """Some of the messages, chosen by their indexes or by a flag for each."""
        return Block(
            self.offset, self.data, self.channel[which], self.sequence[which], self.log_ns[which],
            self.publish_ns[which], self.begin[which], self.end[which],
        )  # fmt: skip

    def by_channel(self) -> Iterator[tuple[int, Block]]:
        """Those of each channel, in order."""
        if not len(self):
            return
        order = np.argsort(self.channel, kind="stable")
        ordered = self.channel[order]
        borders = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
        for rows in np.split(order, borders):
            yield int(self.channel[rows[0]]), self.take(rows)

    def payloads(self) -> bytes:
        """All payloads, one behind the other."""
        lengths = self.end - self.begin
        if len(lengths) and lengths[0] < _SHORT and (lengths == lengths[0]).all():
            return (
                _take_items(self.data, self.begin, np.dtype((np.void, int(lengths[0])))).tobytes()
                if lengths[0]
                else b""
            )
        view = memoryview(self.data)
        return b"".join([view[a:b] for a, b in zip(self.begin.tolist(), self.end.tolist(), strict=True)])

    def alone(self) -> Block:
        """The same without what else stands in `data`."""
        end = np.cumsum(self.end - self.begin)
        return replace(self, data=self.payloads(), begin=end - (self.end - self.begin), end=end)


def renumbered(block: Block, numbers: Mapping[int, int]) -> Block:
    """The same messages with other numbers of their channels."""
    if all(number == own for own, number in numbers.items()):
        return block
    table = np.zeros(max(numbers) + 1, np.uint16)
    table[list(numbers)] = list(numbers.values())
    return replace(block, channel=table[block.channel])


def together(blocks: Sequence[Block]) -> Block:
    """Blocks that follow on one another as one."""
    parts: list[bytes] = []
    shifts: list[int] = []
    length = 0
    for block in blocks:
        if not parts or block.data is not parts[-1]:
            length += len(parts[-1]) if parts else 0
            parts.append(block.data)
        shifts.append(length)

    def joined(name: str, moved: Sequence[int] | None = None) -> Array:
        columns = [getattr(block, name) for block in blocks]
        return np.concatenate(columns if moved is None else [c + by for c, by in zip(columns, moved, strict=True)])

    return Block(
        blocks[0].offset, parts[0] if len(parts) == 1 else b"".join(parts), joined("channel"), joined("sequence"),
        joined("log_ns"), joined("publish_ns"), joined("begin", shifts), joined("end", shifts),
    )  # fmt: skip


class NonsenseError(FleetError):
    """The content of a chunk is not a sequence of records."""


def inside(offset: int, data: bytes) -> Iterator[Block | Schema | Channel]:
    """The records of a chunk in order; `offset` is that of the chunk in the file, `data` its unpacked content. Raises
    NonsenseError where these are no records any more; what stands before was yielded.
    """
    at, size, head, unpack = 0, len(data), HEAD.size, _LENGTH.unpack_from  # looked up once, not per message
    while at < size:
        begins: list[int] = []
        try:
            for _ in range(LOG_RECORD.items):
                begins.append(at)
                at += head + unpack(data, at)[0]
                if at >= size:
                    break
        except struct_error:
            at = size + 1
        end = begins.pop() if at > size else at  # the last one does not end here
        if begins:
            whole = np.array(begins, np.int64)
            yield from _items(offset, data, whole, np.append(whole[1:], end))
        if at > size:
            raise NonsenseError


def _items(offset: int, data: bytes, begin: Array, end: Array) -> Iterator[Block | Schema | Channel]:
    opcode = np.frombuffer(data, np.uint8)[begin]
    message = opcode == int(Opcode.MESSAGE)
    first = 0
    for row in np.flatnonzero(~message | (end - begin < _RECORD.itemsize)).tolist():
        if first < row:
            yield _block(offset, data, begin[first:row], end[first:row])
        first = row + 1
        if message[row]:
            raise NonsenseError
        if opcode[row] in (Opcode.SCHEMA, Opcode.CHANNEL):
            try:
                item = parse(int(opcode[row]), data[begin[row] + HEAD.size : end[row]])
            except BROKEN:
                raise NonsenseError from None
            assert isinstance(item, Schema | Channel)
            yield item
    if first < len(begin):
        yield _block(offset, data, begin[first:], end[first:])


def _block(offset: int, data: bytes, begin: Array, end: Array) -> Block:
    records = _take_items(data, begin, _RECORD)
    channel, sequence, log_ns, publish_ns = (
        np.ascontiguousarray(records[name]) for name in ("channel", "sequence", "log_ns", "publish_ns")
    )
    return Block(offset, data, channel, sequence, log_ns, publish_ns, begin + _RECORD.itemsize, end)


def _take_items(data: bytes, places: Array, kind: np.dtype[Any]) -> Array:
    """The items of one type that begin at these places in `data`. Every item must lie within `data`."""
    every = np.ndarray((len(data) - kind.itemsize + 1,), kind, data, strides=(1,))
    return every[places]


def span_of(body: bytes) -> tuple[int, int] | None:
    """First and last time [ns] that a chunk states, if they can be."""
    try:
        first, last, _, _ = CHUNK.unpack_from(body)
    except struct_error:
        return None
    return (first, last) if first <= last else None


def content(body: bytes, *, exact: bool = False) -> bytes:
    """The unpacked content of a chunk; `exact` as in `parse`. Raises ValueError if it is damaged, or unpacks to
    something else than it states, or to more than is read; its words say which, and are empty of a damaged one.
    """
    try:
        chunk = parse(Opcode.CHUNK, body, exact=exact)
    except BROKEN:
        raise ValueError("") from None
    assert isinstance(chunk, Chunk)
    size, crc = chunk.uncompressed_size, chunk.uncompressed_crc
    if size > LOG_RECORD.bytes:
        raise ValueError(f"a chunk that unpacks to {size} bytes, more than the {LOG_RECORD.bytes} that are read")
    if chunk.compression not in _UNPACK:
        raise ValueError(f"a chunk with the compression {chunk.compression[:20]!r}, which is not known here")
    try:
        data = _UNPACK[chunk.compression](chunk.data, size) if size else b""
    except BROKEN:
        raise ValueError("") from None
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise ValueError("")
    return data


def _zstd(packed: bytes, size: int) -> bytes:
    # The frame states its size too; unchecked it would be allocated.
    if zstandard.get_frame_parameters(packed).content_size not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise ValueError
    return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {
    "zstd": _zstd,
    "lz4": lambda packed, size: lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1),
    "": lambda packed, size: packed,
}


_KINDS: dict[int, Callable[[ReadDataStream], Record]] = {
    Opcode.HEADER: Header.read, Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read, Opcode.CHUNK: Chunk.read,
    Opcode.METADATA: Metadata.read, Opcode.ATTACHMENT: Attachment.read, Opcode.DATA_END: DataEnd.read,
}  # fmt: skip


class _Exact(ReadDataStream):
    """The content of a record, which gives no fewer bytes than it is asked for."""

    def __init__(self, body: bytes) -> None:
        super().__init__(BytesIO(body))
        self.left = len(body)

    def read(self, length: int) -> bytes:
        if length > self.left:  # asked first: a stream takes no length above 63 bits
            raise ValueError
        self.left -= length
        self._count += length
        return self._stream.read(length)


def parse(opcode: int, body: bytes, *, exact: bool = False) -> Record:
    """A record from its content; raises one of `BROKEN` if it is none. Fields that a later version of MCAP, or another
    program, has put behind those that are known are ignored, or with `exact` not taken.
    """
    if opcode not in _KINDS:
        raise ValueError
    stream = _Exact(body)
    item = _KINDS[opcode](stream)
    if exact and stream.left and opcode not in (Opcode.HEADER, Opcode.SCHEMA):
        raise ValueError
    if opcode == Opcode.ATTACHMENT:
        end = stream.count - U32.size
        if (crc := U32.unpack_from(body, end)[0]) and zlib.crc32(memoryview(body)[:end]) != crc:
            raise ValueError
    return item
