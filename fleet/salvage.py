"""MCAP records of a file that may be cut or damaged: what can be trusted is yielded, the rest is counted.

Nothing that stands in the file is believed unchecked: a length must lie within the file and below `MOST_BYTES`, a
chunk must unpack to the size and the CRC it states, an attachment must have its CRC, the summary its own. So a
corrupt length allocates nothing, and a flipped bit is found, not decoded.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from struct import Struct
from struct import error as struct_error
from typing import IO, NamedTuple

import zstandard
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Header, Metadata, Schema

MAGIC = b"\x89MCAP0\r\n"
MOST_BYTES = 64 << 20  # of one record, packed or not; our own chunks hold 1 MiB and one message
_HEAD = Struct("<BQ")
_CHUNK = Struct("<QQQI")  # first and last time [ns], unpacked size, CRC
_MESSAGE = Struct("<HIQQ")
_FOOTER = _HEAD.size + 20  # [bytes]
_U16, _U32, _U64 = Struct("<H"), Struct("<I"), Struct("<Q")
_ZSTD = b"\x04\x00\x00\x00zstd"  # in a chunk, behind its lengths: what it is recognised by when the framing is lost
_WINDOW = 1 << 20
_IN_DATA = frozenset({
    Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END,
})  # fmt: skip


class Message(NamedTuple):
    """One message as it stands in a chunk, times in ns."""

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class ChunkEnd(NamedTuple):
    """Everything before it was in one chunk."""


Item = Header | Schema | Channel | Message | ChunkEnd | Attachment | Metadata | DataEnd


@dataclass(slots=True)
class Damage:
    """A place that cannot be read."""

    offset: int  # [byte]
    what: str
    span_ns: tuple[int, int] | None = None  # which sim time was there, if that can still be read
    messages: int = 0  # lost there, as far as their index says

    def __str__(self) -> str:
        text = f"{self.what} at byte {self.offset}"
        if self.span_ns is not None:
            text += f", t = {self.span_ns[0] / 1e9:g} to {self.span_ns[1] / 1e9:g} s"
        return text + (f", {self.messages} messages" if self.messages else "")


class _DamagedError(Exception):
    def __init__(self, what: str, span_ns: tuple[int, int] | None = None) -> None:
        super().__init__(what)
        self.what, self.span_ns = what, span_ns


@dataclass(slots=True)
class Salvage:
    """Iterates a file's records once. What is wrong with it is there when the iteration is over.

    With `beyond`, goes on behind a damaged place: at the next record if the framing holds, else at the next chunk
    that can be found.
    """

    file: IO[bytes]
    beyond: bool = False
    ended: bool = False  # the data section is there to its end
    indexed: bool = False  # and so is the summary behind it, undamaged
    cut: bool = False  # the file stops in the middle of a record or before its end was written
    damage: list[Damage] = field(default_factory=list)
    messages: int = 0
    stated: int | None = None  # messages, as the summary counts them
    _chunked: bool = field(default=False, init=False)
    _lost_at: int = field(default=-1, init=False)  # where the chunk is damaged whose index is being read

    def __iter__(self) -> Iterator[Item]:
        at = len(MAGIC)
        size = self._size()
        while not self.ended:
            try:
                opcode, body, behind = self._record(at, size)
                if opcode == Opcode.CHUNK:
                    self._chunked = True
                    yield from self._chunk(body)
                elif opcode == Opcode.MESSAGE and self._chunked:
                    # One bit turns an index into a message, which has no CRC of its own.
                    raise _DamagedError("a message outside the chunks")
                elif opcode == Opcode.MESSAGE_INDEX:
                    count = _index_entries(body)
                    if self.damage and self.damage[-1].offset == self._lost_at:
                        self.damage[-1].messages += count
                else:
                    yield from self._plain(opcode, body)
                if opcode != Opcode.MESSAGE_INDEX:
                    self._lost_at = -1
                at = behind
            except EOFError:
                self.cut = True
                return
            except _DamagedError as error:
                self.damage.append(Damage(at, error.what, error.span_ns))
                self._lost_at = at
                found = self._behind(at, size) if self.beyond else None
                if found is None:
                    return
                at = found
        self._summary(at, size)

    def _size(self) -> int:
        return os.fstat(self.file.fileno()).st_size

    def _record(self, at: int, size: int) -> tuple[int, bytes, int]:
        """(opcode, content, where the next one begins) of the record at a byte.

        Raises:
            EOFError: the file ends within it.
        """
        head = self._read(at, _HEAD.size)
        if len(head) < _HEAD.size:
            raise EOFError
        opcode, length = _HEAD.unpack(head)
        if opcode not in _IN_DATA:
            raise _DamagedError(f"a record of unknown kind {opcode:#04x}")
        begin = at + _HEAD.size
        if begin + length > size:
            # A writer that was killed leaves no end; in a file that has one the length itself is wrong.
            if self._read(max(0, size - len(MAGIC)), len(MAGIC)) == MAGIC or self._next_chunk(begin, size) is not None:
                raise _DamagedError("a record whose length is wrong")
            raise EOFError
        if length > MOST_BYTES:
            raise _DamagedError(f"a record of {length} bytes, more than the {MOST_BYTES} that are read")
        return opcode, self._read(begin, length), begin + length

    def _read(self, at: int, length: int) -> bytes:
        if self.file.tell() != at:
            self.file.seek(at)
        return self.file.read(length)

    def _chunk(self, body: bytes) -> Iterator[Item]:
        span: tuple[int, int] | None = None
        try:
            first, last, size, crc = _CHUNK.unpack_from(body)
            span = (first, last) if first <= last else None
            compression, at = _string(body, _CHUNK.size)
            (length,) = _U64.unpack_from(body, at)
            packed = body[at + _U64.size :]
            if length != len(packed):
                raise ValueError
            data = _unpacked(compression, packed, size)
            if crc and zlib.crc32(data) != crc:
                raise ValueError
        except (struct_error, ValueError, zstandard.ZstdError):
            raise _DamagedError("a damaged chunk", span) from None
        yield from self._inside(data)
        yield ChunkEnd()

    def _inside(self, data: bytes) -> Iterator[Item]:
        at, size = 0, len(data)
        message, head, fields = int(Opcode.MESSAGE), _HEAD.size, _MESSAGE.size  # looked up once, not per message
        while at < size:
            try:
                opcode, length = _HEAD.unpack_from(data, at)
                begin = at + head
                at = begin + length
                if at > size:
                    raise ValueError
                if opcode == message:
                    if length < fields:
                        raise ValueError
                    self.messages += 1
                    channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, begin)
                    item: Item = Message(channel, sequence, log_ns, publish_ns, data[begin + fields : at])
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    item = _parse(opcode, data[begin:at])
                else:
                    continue
            except (struct_error, ValueError):
                raise _DamagedError("a chunk whose content makes no sense") from None
            yield item

    def _plain(self, opcode: int, body: bytes) -> Iterator[Item]:
        try:
            item = _parse(opcode, body)
        except (struct_error, ValueError):
            raise _DamagedError(f"a damaged {Opcode(opcode).name.lower().replace('_', ' ')}") from None
        if isinstance(item, DataEnd):
            self.ended = True
        elif isinstance(item, Message):
            self.messages += 1
        yield item

    def _behind(self, at: int, size: int) -> int | None:
        """Where to go on behind a damaged record."""
        head = self._read(at, _HEAD.size)
        if len(head) == _HEAD.size:
            length: int = _HEAD.unpack(head)[1]
            behind = at + _HEAD.size + length
            if self._sound(behind, size):
                return behind
        return self._next_chunk(at + 1, size)

    def _sound(self, at: int, size: int) -> bool:
        """Whether records seem to follow on one another from here."""
        for _ in range(3):
            head = self._read(at, _HEAD.size) if at < size else b""
            if len(head) < _HEAD.size:
                return False
            opcode, length = _HEAD.unpack(head)
            if opcode not in _IN_DATA or length > size - at - _HEAD.size:
                return False
            if opcode == Opcode.DATA_END:
                return bool(length == _U32.size)
            at += _HEAD.size + length
        return True

    def _next_chunk(self, at: int, size: int) -> int | None:
        """Where the next chunk begins, known by its compression between two lengths that fit."""
        before = _HEAD.size + _CHUNK.size
        while at < size:
            window = self._read(at, _WINDOW)
            mark = window.find(_ZSTD)
            while mark >= 0:
                begin = at + mark - before
                if begin >= at or mark >= before:
                    head = window[mark - before : mark]
                    (packed,) = _U64.unpack(self._read(at + mark + len(_ZSTD), 8).ljust(8, b"\xff"))
                    opcode, length = _HEAD.unpack_from(head)
                    whole = _CHUNK.size + len(_ZSTD) + _U64.size + packed
                    if opcode == Opcode.CHUNK and length == whole and begin + _HEAD.size + length <= size:
                        return begin
                mark = window.find(_ZSTD, mark + 1)
            if len(window) < _WINDOW:
                return None
            at += _WINDOW - before - len(_ZSTD)
        return None

    def _summary(self, at: int, size: int) -> None:
        """Check what stands behind the data: only the count of messages is taken from it."""
        total = 0
        try:
            while True:
                head = self._read(at, _HEAD.size)
                opcode, length = _HEAD.unpack(head)
                if length > min(size - at - _HEAD.size, MOST_BYTES):
                    return
                body = self._read(at + _HEAD.size, length)
                at += _HEAD.size + length
                if opcode == Opcode.FOOTER:
                    crc = _U32.unpack_from(body, 16)[0]
                    whole = not crc or zlib.crc32(head + body[:16], total) == crc
                    self.indexed = whole and self._read(at, len(MAGIC) + 1) == MAGIC
                    return
                if opcode == Opcode.STATISTICS:
                    self.stated = _U64.unpack_from(body)[0]
                total = zlib.crc32(head + body, total)
        except struct_error:
            return


def declarations(file: IO[bytes]) -> list[Schema | Channel]:
    """Schemas and channels as the summary repeats them; none if the file has no summary that can be read."""
    found: list[Schema | Channel] = []
    try:
        end = os.fstat(file.fileno()).st_size - len(MAGIC) - _FOOTER
        file.seek(end)
        footer = file.read(_FOOTER)
        opcode, length = _HEAD.unpack_from(footer)
        (at,), (crc,) = _U64.unpack_from(footer, _HEAD.size), _U32.unpack_from(footer, _FOOTER - _U32.size)
        if opcode != Opcode.FOOTER or length != _FOOTER - _HEAD.size or not 0 < at <= end:
            return []
        file.seek(at)
        total = 0
        while at < end:
            head = file.read(_HEAD.size)
            opcode, length = _HEAD.unpack(head)
            at += _HEAD.size + length
            if at > end or length > MOST_BYTES:
                return []
            body = file.read(length)
            total = zlib.crc32(head + body, total)
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                item = _parse(opcode, body)
                assert isinstance(item, Schema | Channel)
                found.append(item)
        if crc and zlib.crc32(footer[: -_U32.size], total) != crc:
            return []
    except (OSError, struct_error, ValueError):
        return []
    return found


def _unpacked(compression: str, packed: bytes, size: int) -> bytes:
    if size > MOST_BYTES:
        raise ValueError
    if not size:
        return b""
    if compression == "zstd":
        # The frame states its size too; unchecked it would be allocated.
        if zstandard.get_frame_parameters(packed).content_size not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError
        data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    elif not compression:
        data = packed
    else:
        raise ValueError
    if len(data) != size:
        raise ValueError
    return data


def _parse(opcode: int, body: bytes) -> Item:
    """A record from its content; raises `struct.error` or `ValueError` if it is none."""
    match opcode:
        case Opcode.HEADER:
            profile, at = _string(body, 0)
            library, at = _string(body, at)
            return Header(profile, library)
        case Opcode.SCHEMA:
            name, at = _string(body, 2)
            encoding, at = _string(body, at)
            return Schema(id=_U16.unpack_from(body)[0], name=name, encoding=encoding, data=_prefixed(body, at)[0])
        case Opcode.CHANNEL:
            topic, at = _string(body, 4)
            encoding, at = _string(body, at)
            number, schema = _U16.unpack_from(body)[0], _U16.unpack_from(body, 2)[0]
            return Channel(id=number, topic=topic, message_encoding=encoding, metadata=_map(body, at), schema_id=schema)
        case Opcode.MESSAGE:
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
            return Message(channel, sequence, log_ns, publish_ns, body[_MESSAGE.size :])
        case Opcode.METADATA:
            name, at = _string(body, 0)
            return Metadata(name=name, metadata=_map(body, at))
        case Opcode.ATTACHMENT:
            name, at = _string(body, 16)
            media_type, at = _string(body, at)
            (length,) = _U64.unpack_from(body, at)
            data = body[at + 8 : at + 8 + length]
            (crc,) = _U32.unpack(body[at + 8 + length :])
            if len(data) != length or (crc and zlib.crc32(body[:-4]) != crc):
                raise ValueError
            log_time, create_time = _U64.unpack_from(body)[0], _U64.unpack_from(body, 8)[0]
            return Attachment(create_time=create_time, log_time=log_time, name=name, media_type=media_type, data=data)
        case Opcode.DATA_END:
            return DataEnd(_U32.unpack(body)[0])
    raise ValueError


def _prefixed(body: bytes, at: int) -> tuple[bytes, int]:
    (length,) = _U32.unpack_from(body, at)
    end = at + 4 + length
    if end > len(body):
        raise ValueError
    return body[at + 4 : end], end


def _string(body: bytes, at: int) -> tuple[str, int]:
    data, end = _prefixed(body, at)
    return data.decode("utf-8"), end


def _map(body: bytes, at: int) -> dict[str, str]:
    data, end = _prefixed(body, at)
    if end != len(body):
        raise ValueError
    found: dict[str, str] = {}
    at = 0
    while at < len(data):
        key, at = _string(data, at)
        found[key], at = _string(data, at)
    return found


def _index_entries(body: bytes) -> int:
    if len(body) < 6 or _U32.unpack_from(body, 2)[0] != len(body) - 6 or (len(body) - 6) % 16:
        raise _DamagedError("a damaged message index")
    return (len(body) - 6) // 16
