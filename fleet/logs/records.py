"""The records of an MCAP file, each parsed from its own bytes, and what a chunk unpacks to: never more than a bound."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from struct import Struct
from struct import error as struct_error
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Header, Metadata, Schema

from fleet.errors import FleetError

MAGIC = b"\x89MCAP0\r\n"
MOST_BYTES = 64 << 20  # of one record, packed or not; our own chunks hold 1 MiB and one message
MOST_IN_BLOCK = 65_536  # messages
_SHORT, _AT_ONCE = 1024, 4096  # bytes of payloads, and how many of them, that are gathered by numpy
HEAD = Struct("<BQ")
CHUNK = Struct("<QQQI")  # first and last time [ns], unpacked size, CRC
MESSAGE = Struct("<HIQQ")
U16, U32, U64 = Struct("<H"), Struct("<I"), Struct("<Q")
_FIELDS = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")])
_BROKEN = (struct_error, ValueError, RuntimeError, zstandard.ZstdError)  # lz4 raises RuntimeError

Array = np.ndarray[Any, np.dtype[Any]]


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

    offset: int  # of the chunk, or of the first message outside chunks [byte of the file]
    data: bytes  # in which they stand
    channel: Array
    sequence: Array
    log_ns: Array
    publish_ns: Array
    begin: Array  # of each payload in `data`
    end: Array

    def __len__(self) -> int:
        return len(self.channel)

    def messages(self) -> Iterator[Message]:
        """One by one."""
        columns = (self.channel, self.sequence, self.log_ns, self.publish_ns, self.begin, self.end)
        data = self.data
        for channel, sequence, log_ns, publish_ns, begin, end in zip(*(c.tolist() for c in columns), strict=True):
            yield Message(channel, sequence, log_ns, publish_ns, data[begin:end])

    def take(self, which: Array) -> Block:
        """Some of them, by index or by a flag for each."""
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
            whole, places = np.frombuffer(self.data, np.uint8), np.arange(lengths[0])
            # Some at a time: an index takes eight times as much as what it points to.
            return b"".join(
                whole[self.begin[first : first + _AT_ONCE, None] + places].tobytes()
                for first in range(0, len(self), _AT_ONCE)
            )
        view = memoryview(self.data)
        return b"".join([view[a:b] for a, b in zip(self.begin.tolist(), self.end.tolist(), strict=True)])


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
    """The records of a chunk at an offset, in order.

    Raises:
        NonsenseError: from some place on these are no records; what stands before was yielded.
    """
    at, size = 0, len(data)
    message, head, fields = int(Opcode.MESSAGE), HEAD.size, MESSAGE.size  # looked up once, not per message
    unpack = HEAD.unpack_from
    begins: list[int] = []
    ends: list[int] = []
    try:
        while at < size:
            opcode, length = unpack(data, at)
            begin = at + head
            at = begin + length
            if at > size:
                raise ValueError
            if opcode == message:
                if length < fields:
                    raise ValueError
                begins.append(begin)
                ends.append(at)
                if len(begins) < MOST_IN_BLOCK:
                    continue
            elif opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
                continue
            if begins:
                yield _block(offset, data, begins, ends)
                begins, ends = [], []
            if opcode != message:
                item = parse(opcode, data[begin:at])
                assert isinstance(item, Schema | Channel)
                yield item
    except (struct_error, ValueError):
        if begins:
            yield _block(offset, data, begins, ends)
        raise NonsenseError from None
    if begins:
        yield _block(offset, data, begins, ends)


def _block(offset: int, data: bytes, begins: list[int], ends: list[int]) -> Block:
    begin = np.array(begins, np.int64)
    whole = np.frombuffer(data, np.uint8)
    fields = whole[begin[:, None] + np.arange(MESSAGE.size)].view(_FIELDS)[:, 0]
    channel, sequence, log_ns, publish_ns = (
        np.ascontiguousarray(fields[name]) for name in ("channel", "sequence", "log_ns", "publish_ns")
    )
    return Block(
        offset, data, channel, sequence, log_ns, publish_ns, begin + MESSAGE.size, np.array(ends, np.int64)
    )  # fmt: skip


def span_of(body: bytes) -> tuple[int, int] | None:
    """First and last time [ns] that a chunk states, if they can be."""
    try:
        first, last, _, _ = CHUNK.unpack_from(body)
    except struct_error:
        return None
    return (first, last) if first <= last else None


def content(body: bytes) -> bytes:
    """The unpacked content of a chunk.

    Raises:
        ValueError: it is damaged, or unpacks to something else than it states, or to more than is read; its words
            say which, and are empty of a damaged one.
    """
    try:
        _, _, size, crc = CHUNK.unpack_from(body)
        compression, at = string(body, CHUNK.size)
        (length,) = U64.unpack_from(body, at)
        packed = memoryview(body)[at + U64.size :]
    except _BROKEN:
        raise ValueError("") from None
    if size > MOST_BYTES:
        raise ValueError(f"a chunk that unpacks to {size} bytes, more than the {MOST_BYTES} that are read")
    if compression not in _UNPACK:
        raise ValueError(f"a chunk with the compression {compression[:20]!r}, which is not known here")
    try:
        data = _UNPACK[compression](packed, size) if length == len(packed) and size else b""
    except _BROKEN:
        raise ValueError("") from None
    if length != len(packed) or len(data) != size or (crc and zlib.crc32(data) != crc):
        raise ValueError("")
    return data


def _zstd(packed: memoryview, size: int) -> bytes:
    # The frame states its size too; unchecked it would be allocated.
    if zstandard.get_frame_parameters(packed).content_size not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise ValueError
    return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)


def _lz4(packed: memoryview, size: int) -> bytes:
    found: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    return found


_UNPACK: dict[str, Callable[[memoryview, int], bytes]] = {
    "zstd": _zstd,
    "lz4": _lz4,
    "": lambda packed, size: bytes(packed),
}


def parse(opcode: int, body: bytes) -> Schema | Channel | Header | Metadata | Attachment | DataEnd:
    """A record from its content; raises `struct.error` or `ValueError` if it is none."""
    match opcode:
        case Opcode.HEADER:
            profile, at = string(body, 0)
            library, at = string(body, at)
            return Header(profile, library)
        case Opcode.SCHEMA:
            name, at = string(body, 2)
            encoding, at = string(body, at)
            return Schema(id=U16.unpack_from(body)[0], name=name, encoding=encoding, data=_prefixed(body, at)[0])
        case Opcode.CHANNEL:
            topic, at = string(body, 4)
            encoding, at = string(body, at)
            number, schema = U16.unpack_from(body)[0], U16.unpack_from(body, 2)[0]
            return Channel(id=number, topic=topic, message_encoding=encoding, metadata=_map(body, at), schema_id=schema)
        case Opcode.METADATA:
            name, at = string(body, 0)
            return Metadata(name=name, metadata=_map(body, at))
        case Opcode.ATTACHMENT:
            name, at = string(body, 16)
            media_type, at = string(body, at)
            (length,) = U64.unpack_from(body, at)
            data = body[at + 8 : at + 8 + length]
            (crc,) = U32.unpack(body[at + 8 + length :])
            if len(data) != length or (crc and zlib.crc32(memoryview(body)[:-4]) != crc):
                raise ValueError
            log_time, create_time = U64.unpack_from(body)[0], U64.unpack_from(body, 8)[0]
            return Attachment(create_time=create_time, log_time=log_time, name=name, media_type=media_type, data=data)
        case Opcode.DATA_END:
            return DataEnd(U32.unpack(body)[0])
    raise ValueError


def _prefixed(body: bytes, at: int) -> tuple[bytes, int]:
    (length,) = U32.unpack_from(body, at)
    end = at + 4 + length
    if end > len(body):
        raise ValueError
    return body[at + 4 : end], end


def string(body: bytes, at: int) -> tuple[str, int]:
    """A text with its length before it, and where it ends."""
    data, end = _prefixed(body, at)
    return data.decode("utf-8"), end


def _map(body: bytes, at: int) -> dict[str, str]:
    data, end = _prefixed(body, at)
    if end != len(body):
        raise ValueError
    found: dict[str, str] = {}
    at = 0
    while at < len(data):
        key, at = string(data, at)
        found[key], at = string(data, at)
    return found
