"""MCAP records of a file that may be cut or damaged: good records are yielded, the others are counted.

Every value in the file is checked first. A length must lie within the file and below `LOG_RECORD.bytes`, a chunk must
unpack to the size and the CRC that it states, an attachment must have its CRC, and the summary its own. So a corrupt
length allocates nothing, and a flipped bit is found, not decoded. (23,000 files with flipped bytes gave no wrong value
and no exception.)

The library's reader was rejected. It reads 200,000 messages/s against 495,000 here. It believes a damaged length, so a
flipped bit may ask for a petabyte, and it cannot go on behind a damaged chunk.

Files of other programs may have what the specification lets readers ignore: records of unknown kinds, bytes behind the
known fields of a record, and messages between chunks. In a file that this program wrote, each of these is damage.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from struct import Struct
from typing import IO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Metadata, Schema

from fleet.mcap.records import (
    BROKEN,
    CHUNK,
    HEAD,
    LIBRARY,
    MAGIC,
    MESSAGE,
    U32,
    U64,
    Block,
    NonsenseError,
    content,
    inside,
    parse,
    span_of,
)
from netem.limits import LOG_RECORD

_INDEX = Struct("<BQHI")  # how a message index begins: opcode, length of the rest, channel, bytes of its entries
_INDEX_WINDOW = 1 << 16  # bytes of message indexes that are looked at together
_FOOTER = HEAD.size + 20  # [bytes]
_ZSTD = b"\x04\x00\x00\x00zstd"  # in a chunk, behind its lengths: what it is recognised by when the framing is lost
_WINDOW = 1 << 20
_LOOSE = 1 << 20  # bytes of messages outside chunks that make one block
_TOO_LATE_NS = 1 << 63  # no log has such times: read as a signed number they lie before 1970
_LATER_NS = 60 * 10**9  # after the end of a run; a later time in its log is a mistake
_TELL = 1 << 20  # bytes of the file between two calls of `on_progress`
_IN_DATA = frozenset({
    Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END,
})  # fmt: skip
_UNKNOWN = range(max(Opcode) + 1, 0x100)  # records of later versions, and from 0x80 on of other programs


class ChunkEnd(NamedTuple):
    """Everything before it was in one chunk."""


Item = Header | Schema | Channel | Block | ChunkEnd | Attachment | Metadata | DataEnd


@dataclass(slots=True)
class Damage:
    """A place that cannot be read."""

    offset: int  # [byte]
    what: str
    span_ns: tuple[int, int] | None = None  # first and last simulated time there, if they can still be read
    messages: int = 0  # lost there, as far as their index states

    def __str__(self) -> str:
        text = f"{self.what} at byte {self.offset}"
        if self.span_ns is not None:
            text += f", t = {self.span_ns[0] / 1e9:g} to {self.span_ns[1] / 1e9:g} s"
        return text + (f", {self.messages} messages" if self.messages else "")


class _DamagedError(Exception):
    """What cannot be read, and perhaps the time that was there, as for `Damage`."""


@dataclass(slots=True)
class Salvage:
    """Iterates a file's records once; then the faults of the file are known. With `beyond`, goes on behind a damaged
    place: at the next record if the framing holds, else at the next chunk that can be found.
    """

    file: IO[bytes]
    beyond: bool = False
    at: int = len(MAGIC)  # where the record at hand begins [byte]
    on_progress: Callable[[float], None] = lambda _: (
        None
    )  # called now and then with the share of the file that was read
    ended: bool = False  # the data section is there to its end
    indexed: bool = False  # the summary is there, too, undamaged
    cut: bool = False  # the file stops in the middle of a record or before its end was written
    damage: list[Damage] = field(default_factory=list)
    messages: int = 0
    stated: int | None = None  # messages, as the summary counts them
    _ours: bool = field(default=False, init=False)  # this program wrote the file, as its header says
    _chunked: bool = field(default=False, init=False)
    _lost_at: int = field(default=-1, init=False)  # where the chunk is damaged whose index is being read
    _loose: bytearray = field(default_factory=bytearray, init=False)  # messages outside chunks, as they are
    _loose_at: int = field(default=0, init=False)
    _told: int = field(default=0, init=False)
    _too_late_ns: int = field(default=_TOO_LATE_NS, init=False)

    def __iter__(self) -> Iterator[Item]:
        for item in self._items():
            if not isinstance(item, Block):
                if isinstance(item, Metadata) and item.name == "run":
                    self._too_late_ns = _too_late_ns(item.metadata)
                yield item
                continue
            sound = (item.log_ns < self._too_late_ns) & (item.publish_ns < self._too_late_ns)
            kept = item
            if not sound.all():
                wrong = int((~sound).sum())
                self.damage.append(Damage(item.offset, self._why_unsound(), messages=wrong if self.beyond else 0))
                kept = item.take(sound if self.beyond else np.arange(int(sound.argmin())))
            self.messages += len(kept)
            if len(kept):
                yield kept
            if kept is not item and not self.beyond:
                return

    def _why_unsound(self) -> str:
        if self._too_late_ns == _TOO_LATE_NS:
            return "a message whose time is beyond the year 2262"
        end_s = (self._too_late_ns - _LATER_NS) / 1e9
        return f"a message whose time is long after the end of the run ({end_s:g} s)"

    def _items(self) -> Iterator[Item]:
        size = self._size()
        while not self.ended:
            try:
                opcode, body, behind = self._record(self.at, size)
                if self.at - self._told >= _TELL or self._told == 0:
                    self._told = self.at
                    self.on_progress(self.at / size)
                if opcode == Opcode.MESSAGE and not (self._ours and self._chunked):
                    if self._gather(body, behind):
                        yield from self._gathered()
                elif opcode == Opcode.CHUNK:
                    yield from self._gathered()
                    yield from self._chunk(body)
                    if not self.damage:  # with damage each index counts what is lost
                        behind = self._behind_indexes(behind)
                elif opcode not in _UNKNOWN:
                    yield from self._gathered()
                    yield from self._one(opcode, body)
                if opcode != Opcode.MESSAGE_INDEX:
                    self._lost_at = -1
                self.at = behind
            except EOFError:
                self.cut = True
                yield from self._gathered()
                return
            except _DamagedError as error:
                yield from self._gathered()
                self.damage.append(Damage(self.at, *error.args))
                self._lost_at = self.at
                found = self._behind(self.at, size) if self.beyond else None
                if found is None:
                    return
                self.at = found
        self.indexed, self.stated = self._summary(self.at, size, [])

    def _one(self, opcode: int, body: bytes) -> Iterator[Item]:
        if opcode == Opcode.MESSAGE:
            # One bit turns an index into a message, which has no CRC of its own.
            raise _DamagedError("a message outside the chunks")
        elif opcode == Opcode.MESSAGE_INDEX:
            # A channel, and a time and a place for each message.
            entries, more = U32.unpack_from(body, 2)[0] if len(body) >= 6 else 0, len(body) - 6
            if entries % 16 or entries > more or (self._ours and entries < more):
                raise _DamagedError("a damaged message index")
            if self.damage and self.damage[-1].offset == self._lost_at:
                self.damage[-1].messages += entries // 16
        else:
            yield from self._plain(opcode, body)

    def _gather(self, body: bytes, behind: int) -> bool:
        """Keep a message that is in no chunk until there are some; whether there are."""
        if len(body) < MESSAGE.size:
            raise _DamagedError("a damaged message")
        if not self._loose:
            self._loose_at = self.at
        self._loose += HEAD.pack(Opcode.MESSAGE, len(body)) + body
        return len(self._loose) >= _LOOSE

    def _gathered(self) -> Iterator[Item]:
        if self._loose:
            data = bytes(self._loose)
            self._loose.clear()
            yield from inside(self._loose_at, data)

    def _size(self) -> int:
        return os.fstat(self.file.fileno()).st_size

    def _record(self, at: int, size: int) -> tuple[int, bytes, int]:
        """(opcode, content, where the next one begins) of the record at a byte. Raises EOFError if the file ends within
        it.
        """
        head = self._read(at, HEAD.size)
        if len(head) < HEAD.size:
            raise EOFError
        opcode, length = HEAD.unpack(head)
        if not self._allowed(opcode):
            raise _DamagedError(f"a record of unknown kind {opcode:#04x}")
        begin = at + HEAD.size
        if begin + length > size:
            # A writer that was killed leaves no end; in a file that has one the length itself is wrong.
            if self._read(max(0, size - len(MAGIC)), len(MAGIC)) == MAGIC or self._next_chunk(begin, size) is not None:
                raise _DamagedError("a record whose length is wrong")
            raise EOFError
        if opcode in _UNKNOWN:
            return opcode, b"", begin + length
        if length > LOG_RECORD.bytes:
            raise _DamagedError(f"a record of {length} bytes, more than the {LOG_RECORD.bytes} that are read")
        return opcode, self._read(begin, length), begin + length

    def _allowed(self, opcode: int) -> bool:
        return opcode in _IN_DATA or (opcode in _UNKNOWN and not self._ours)

    def _read(self, at: int, length: int) -> bytes:
        if self.file.tell() != at:
            self.file.seek(at)
        return self.file.read(length)

    def _chunk(self, body: bytes) -> Iterator[Item]:
        self._chunked = True
        try:
            data = content(body, exact=self._ours)
        except ValueError as error:
            raise _DamagedError(str(error) or "a damaged chunk", span_of(body)) from None
        try:
            yield from inside(self.at, data)
        except NonsenseError:
            raise _DamagedError("a chunk whose content makes no sense") from None
        yield ChunkEnd()

    def _plain(self, opcode: int, body: bytes) -> Iterator[Item]:
        try:
            item = parse(opcode, body, exact=self._ours)
        except BROKEN:
            raise _DamagedError(f"a damaged {Opcode(opcode).name.lower().replace('_', ' ')}") from None
        assert not isinstance(item, Chunk)
        self.ended = isinstance(item, DataEnd)
        self._ours = self._ours or (isinstance(item, Header) and item.library == LIBRARY)
        yield item

    def _behind_indexes(self, at: int) -> int:
        """Where the sound message indexes end that begin at a byte: a log of a thousand vehicles has ten million."""
        index, head, unpack = int(Opcode.MESSAGE_INDEX), _INDEX.size, _INDEX.unpack_from
        while True:
            window = self._read(at, _INDEX_WINDOW)
            begin, last = 0, len(window) - head
            while begin <= last:
                opcode, length, _, entries = unpack(window, begin)
                end = begin + head + entries
                if opcode != index or length != entries + 6 or entries % 16 or end > len(window):
                    break
                begin = end
            at += begin
            if not begin or len(window) < _INDEX_WINDOW:
                return at

    def _behind(self, at: int, size: int) -> int | None:
        head = self._read(at, HEAD.size)
        if len(head) == HEAD.size:
            length: int = HEAD.unpack(head)[1]
            behind = at + HEAD.size + length
            if self._sound(behind, size):
                return behind
        return self._next_chunk(at + 1, size)

    def _sound(self, at: int, size: int) -> bool:
        for _ in range(3):
            head = self._read(at, HEAD.size) if at < size else b""
            if len(head) < HEAD.size:
                return False
            opcode, length = HEAD.unpack(head)
            if not self._allowed(opcode) or length > size - at - HEAD.size:
                return False
            if opcode == Opcode.DATA_END:
                return bool(length == U32.size)
            at += HEAD.size + length
        return True

    def _next_chunk(self, at: int, size: int) -> int | None:
        """Where the next chunk begins, known by its compression between two lengths that fit."""
        before = HEAD.size + CHUNK.size
        while at < size:
            window = self._read(at, _WINDOW)
            mark = window.find(_ZSTD)
            while mark >= 0:
                begin = at + mark - before
                if begin >= at or mark >= before:
                    head = window[mark - before : mark]
                    (packed,) = U64.unpack(self._read(at + mark + len(_ZSTD), 8).ljust(8, b"\xff"))
                    opcode, length = HEAD.unpack_from(head)
                    whole = CHUNK.size + len(_ZSTD) + U64.size + packed
                    if opcode == Opcode.CHUNK and length == whole and begin + HEAD.size + length <= size:
                        return begin
                mark = window.find(_ZSTD, mark + 1)
            if len(window) < _WINDOW:
                return None
            at += _WINDOW - before - len(_ZSTD)
        return None

    def declarations(self) -> list[Schema | Channel]:
        """Schemas and channels as the summary repeats them; none if the file has no summary that can be read."""
        size = self._size()
        place = size - len(MAGIC) - _FOOTER + HEAD.size  # the place that says where the summary begins
        found: list[Schema | Channel] = []
        if place < 0:
            return found
        (at,) = U64.unpack(self._read(place, U64.size))
        return found if 0 < at < place and self._summary(at, size, found)[0] else []

    def _summary(self, at: int, size: int, declared: list[Schema | Channel]) -> tuple[bool, int | None]:
        """Whether what stands behind the data is undamaged, and how many messages it counts."""
        total, stated = 0, None
        try:
            while True:
                head = self._read(at, HEAD.size)
                opcode, length = HEAD.unpack(head)
                if length > min(size - at - HEAD.size, LOG_RECORD.bytes):
                    return False, stated
                body = self._read(at + HEAD.size, length)
                at += HEAD.size + length
                if opcode == Opcode.FOOTER:
                    crc = U32.unpack_from(body, 16)[0]
                    whole = not crc or zlib.crc32(head + body[:16], total) == crc
                    return whole and self._read(at, len(MAGIC) + 1) == MAGIC, stated
                if opcode == Opcode.STATISTICS:
                    stated = U64.unpack_from(body)[0]
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    item = parse(opcode, body)
                    assert isinstance(item, Schema | Channel)
                    declared.append(item)
                total = zlib.crc32(head + body, total)
        except BROKEN:
            return False, stated


def _too_late_ns(run: Mapping[str, str]) -> int:
    """The first time that no message of a run can have, as its metadata tell; of another log, the last of all."""
    try:
        end_ns = int(run["tick_ns"]) * int(run["ticks"])
    except (KeyError, ValueError):
        return _TOO_LATE_NS
    return min(end_ns + _LATER_NS, _TOO_LATE_NS) if "uuv-fleet" in run and end_ns >= 0 else _TOO_LATE_NS
