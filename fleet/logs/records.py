"""The records of an MCAP file, each parsed from its own bytes, and what a chunk unpacks to: never more than a bound."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
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

# --- digest
# The digest of a log: SHA-256 over its ordered messages, whatever the chunks and the compression of the file.


_TIMES = Struct("<QQII").pack
_STAMP = np.dtype([("log", "<u8"), ("publish", "<u8"), ("sequence", "<u4"), ("length", "<u4")])  # the same, of many
_MOST_PARTS = 3000  # of 1000 messages; hashing them in one piece costs less than one by one
_MOST_BYTES = 64 * 1024  # of batches


class Digest:
    """Takes the messages of a log in their order."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._parts: list[bytes] = []
        self._held = 0  # bytes of batches among the parts

    def add(self, topic: bytes, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Take one message: `topic` in UTF-8, both times in ns of simulated time."""
        parts = self._parts
        parts += (topic, _TIMES(log_ns, publish_ns, sequence, len(data)), data)
        if len(parts) >= _MOST_PARTS:
            self._take()

    def add_batch(self, digested: bytes) -> None:
        """Take messages that are put together already: of each what `add` takes, in that order."""
        self._parts.append(digested)
        self._held += len(digested)
        if self._held >= _MOST_BYTES:
            self._take()

    def add_block(self, block: Block, topics: Mapping[int, bytes]) -> None:
        """Take the messages of a block; `topics` are the topics of its channels, in UTF-8."""
        stamps = np.empty(len(block), _STAMP)
        stamps["log"], stamps["publish"], stamps["sequence"] = block.log_ns, block.publish_ns, block.sequence
        stamps["length"] = block.end - block.begin
        packed, data, size = stamps.tobytes(), block.data, _STAMP.itemsize
        parts = self._parts
        columns = zip(block.channel.tolist(), block.begin.tolist(), block.end.tolist(), strict=True)
        for at, (channel, begin, end) in zip(range(0, len(packed), size), columns, strict=True):
            parts += (topics[channel], packed[at : at + size], data[begin:end])
        self._take()

    def hexdigest(self) -> str:
        """The digest of all messages so far, in hexadecimal."""
        self._take()
        return self._hash.hexdigest()

    def _take(self) -> None:
        self._hash.update(b"".join(self._parts))
        self._parts.clear()
        self._held = 0


MAGIC = b"\x89MCAP0\r\n"
MOST_BYTES = 64 << 20  # of one record, packed or not; our own chunks hold 1 MiB and one message
MOST_IN_BLOCK = 65_536  # messages
_SHORT = 1024  # bytes of payloads that are gathered by numpy
HEAD = Struct("<BQ")
CHUNK = Struct("<QQQI")  # first and last time [ns], unpacked size, CRC
MESSAGE = Struct("<HIQQ")
U16, U32, U64 = Struct("<H"), Struct("<I"), Struct("<Q")
_RECORD = np.dtype([
    ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"),
    ("publish_ns", "<u8"),
])  # fmt: skip
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
            return _at(self.data, self.begin, np.dtype((np.void, int(lengths[0])))).tobytes() if lengths[0] else b""
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


def inside(offset: int, data: bytes, places: Array | None = None) -> Iterator[Block | Schema | Channel]:
    """The records of a chunk at an offset, in order.

    Args:
        offset: of the chunk in the file.
        data: the unpacked content of the chunk.
        places: where in it an index says that the messages are. It is quicker to check this than to go from record
            to record, and the result is the same: a wrong index is not used.

    Raises:
        NonsenseError: from some place on these are no records; what stands before was yielded.
    """
    indexed = None if places is None else _indexed(offset, data, places)
    yield from _walked(offset, data) if indexed is None else indexed


def _indexed(offset: int, data: bytes, places: Array) -> list[Block | Schema | Channel] | None:
    """The records of a chunk whose messages are at these places; None if they are not, or if others are there too."""
    size = len(data)
    if not 0 < len(places) <= MOST_IN_BLOCK or int(places.max()) > size - _RECORD.itemsize:
        return None
    begin = np.sort(places).astype(np.int64)
    records = _at(data, begin, _RECORD)
    lengths = records["length"]
    if (records["opcode"] != int(Opcode.MESSAGE)).any() or lengths.min() < MESSAGE.size or lengths.max() > size:
        return None
    end = begin + (HEAD.size + lengths.astype(np.int64))
    before, after = np.append(0, end), np.append(begin, size)  # between them other records stand, or nothing
    if (before > after).any():
        return None
    found: list[Block | Schema | Channel] = []
    first = 0
    for row in np.flatnonzero(before < after).tolist():
        items = _others(data, int(before[row]), int(after[row]))
        if items is None:
            return None
        if items and first < row:
            found.append(_block(offset, data, records[first:row], begin[first:row], end[first:row]))
            first = row
        found += items
    if first < len(begin):
        found.append(_block(offset, data, records[first:], begin[first:], end[first:]))
    return found


def _others(data: bytes, at: int, end: int) -> list[Schema | Channel] | None:
    """The declarations between two places; None if messages stand there, or anything but records."""
    found: list[Schema | Channel] = []
    try:
        while at < end:
            opcode, length = HEAD.unpack_from(data, at)
            begin, at = at + HEAD.size, at + HEAD.size + length
            if at > end or opcode == Opcode.MESSAGE:
                return None
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                item = parse(opcode, data[begin:at])
                assert isinstance(item, Schema | Channel)
                found.append(item)
    except (struct_error, ValueError):
        return None
    return found


def _walked(offset: int, data: bytes) -> Iterator[Block | Schema | Channel]:
    """The same without an index, from record to record."""
    at, size = 0, len(data)
    message, head, fields = int(Opcode.MESSAGE), HEAD.size, MESSAGE.size  # looked up once, not per message
    unpack = HEAD.unpack_from
    places: list[int] = []
    try:
        while at < size:
            opcode, length = unpack(data, at)
            place, begin = at, at + head
            at = begin + length
            if at > size:
                raise ValueError
            if opcode == message:
                if length < fields:
                    raise ValueError
                places.append(place)
                if len(places) < MOST_IN_BLOCK:
                    continue
            elif opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
                continue
            if places:
                yield _placed(offset, data, places)
                places = []
            if opcode != message:
                item = parse(opcode, data[begin:at])
                assert isinstance(item, Schema | Channel)
                yield item
    except (struct_error, ValueError):
        if places:
            yield _placed(offset, data, places)
        raise NonsenseError from None
    if places:
        yield _placed(offset, data, places)


def _placed(offset: int, data: bytes, places: list[int]) -> Block:
    begin = np.array(places, np.int64)
    records = _at(data, begin, _RECORD)
    return _block(offset, data, records, begin, begin + (HEAD.size + records["length"].astype(np.int64)))


def _block(offset: int, data: bytes, records: Array, begin: Array, end: Array) -> Block:
    channel, sequence, log_ns, publish_ns = (
        np.ascontiguousarray(records[name]) for name in ("channel", "sequence", "log_ns", "publish_ns")
    )
    return Block(offset, data, channel, sequence, log_ns, publish_ns, begin + _RECORD.itemsize, end)


def _at(data: bytes, places: Array, kind: np.dtype[Any]) -> Array:
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
