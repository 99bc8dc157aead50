"""An MCAP file as a tape: every message by its number, without holding the payloads in memory.

One pass over the file notes where each chunk lies and when each message is due, and checks the chunks; a message
costs 10 bytes of memory, and a chunk is decompressed again when one of its messages is wanted. What cannot be read
ends the tape there, with a word on what is missing.
"""

from __future__ import annotations

import io
import struct
from array import array
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from zstandard import ZstdError

from fleet.reader import LogReadError, open_file
from fleet.salvage import MAGIC

Times = np.ndarray[Any, np.dtype[np.int64]]
Numbers = np.ndarray[Any, np.dtype[np.int64]]

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_DECODED = 3  # chunks kept decompressed: the one played, and both sides of it
_CUT = "the file is cut: it was not closed, or is still being written"


class Entry(NamedTuple):
    """One message; times in ns."""

    channel: Channel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class _Block(NamedTuple):
    """Where messages lie: a chunk of the file, or messages that stand outside chunks, as they are."""

    offset: int
    length: int
    loose: bytes | None


class Tape:
    """The messages of an MCAP file in the order of the file."""

    def __init__(self, path: Path) -> None:
        """Read it through.

        Raises:
            LogReadError: the file cannot be opened, is no MCAP file, or has no complete message.
        """
        self.path = path
        self.profile = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.missing = ""  # why the file is not whole; "" if it is
        self._blocks: list[_Block] = []
        self._firsts: list[int] = []  # number of each block's first message
        self._times = array("q")
        self._of = array("H")
        self._loose = bytearray()
        self._decoded: OrderedDict[int, tuple[bytes, list[tuple[int, int]]]] = OrderedDict()
        try:
            with open_file(path) as file:
                self._scan(file)
        except (CRCValidationError, ZstdError):
            self.missing = "a chunk is damaged (a flipped bit, for instance); the tape ends before it"
        # A cut or damaged file is any of these to mcap's parser.
        except (McapError, struct.error, ValueError, KeyError, EOFError, MemoryError, OverflowError):
            self.missing = _CUT
        self._end_loose()
        if not self._times:
            raise LogReadError(f"{path} holds no message{f': {self.missing}' if self.missing else ''}")
        # A message earlier than the one before it is due together with it: the order of the file is kept.
        self.times: Times = np.maximum.accumulate(np.frombuffer(self._times, dtype=np.int64))
        self.channel_of: np.ndarray[Any, np.dtype[np.uint16]] = np.frombuffer(self._of, dtype=np.uint16)

    def __len__(self) -> int:
        return len(self._times)

    def __getitem__(self, number: int) -> Entry:
        """Message `number`, from 0."""
        block = bisect_right(self._firsts, number) - 1
        data, places = self._open(block)
        at, end = places[number - self._firsts[block]]
        channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, at)
        return Entry(self.channels[channel], sequence, log_ns, publish_ns, data[at + _MESSAGE.size : end])

    def _scan(self, file: IO[bytes]) -> None:
        size = self.path.stat().st_size
        offset = len(MAGIC)
        file.seek(offset)
        while True:
            opcode, length = _HEAD.unpack(file.read(_HEAD.size))
            offset += _HEAD.size
            if offset + length > size:
                raise EOFError
            if opcode == Opcode.DATA_END:
                return
            if opcode == Opcode.CHUNK:
                self._end_loose()
                content = _chunk(file, offset, length)
                self._note(content, _Block(offset, length, None))
            elif opcode in (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.MESSAGE):
                record = file.read(length)
                if opcode == Opcode.MESSAGE:
                    self._loose += _HEAD.pack(opcode, length) + record
                else:
                    self._take(opcode, record)
            offset += length
            file.seek(offset)

    def _end_loose(self) -> None:
        if self._loose:
            content = bytes(self._loose)
            self._loose.clear()
            self._note(content, _Block(0, 0, content))

    def _note(self, content: bytes, block: _Block) -> None:
        """Enter a block's messages, all or none."""
        times, channels = array("q"), array("H")
        for at, _ in _messages(content, self._take):
            channel, _, log_ns, _ = _MESSAGE.unpack_from(content, at)
            self.channels[channel]  # a message of no channel is damage: KeyError
            times.append(log_ns)
            channels.append(channel)
        self._blocks.append(block)
        self._firsts.append(len(self._times))
        self._times += times
        self._of += channels

    def _take(self, opcode: int, record: bytes) -> None:
        stream = ReadDataStream(io.BytesIO(record))
        match opcode:
            case Opcode.HEADER:
                self.profile = Header.read(stream).profile
            case Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = Channel.read(stream)
                self.channels[channel.id] = channel
            case Opcode.METADATA:
                metadata = Metadata.read(stream)
                self.metadata[metadata.name] = dict(metadata.metadata)

    def _open(self, number: int) -> tuple[bytes, list[tuple[int, int]]]:
        if number in self._decoded:
            self._decoded.move_to_end(number)
            return self._decoded[number]
        block = self._blocks[number]
        content = block.loose
        if content is None:
            with open_file(self.path) as file:
                content = _chunk(file, block.offset, block.length)
        found = content, list(_messages(content, lambda opcode, record: None))
        self._decoded[number] = found
        if len(self._decoded) > _DECODED:
            self._decoded.popitem(last=False)
        return found


def _chunk(file: IO[bytes], offset: int, length: int) -> bytes:
    """What a chunk holds, decompressed and checked."""
    file.seek(offset)
    chunk = Chunk.read(ReadDataStream(io.BytesIO(file.read(length))))
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return bytes(stream.read(size))


def _messages(content: bytes, other: Any) -> Iterator[tuple[int, int]]:
    """(begin, end) of every message record; `other(opcode, bytes)` is given the rest."""
    at, size = 0, len(content)
    while at < size:
        opcode, length = _HEAD.unpack_from(content, at)
        at += _HEAD.size
        end = at + length
        if end > size:
            raise EOFError
        if opcode == Opcode.MESSAGE:
            yield at, end
        else:
            other(opcode, content[at:end])
        at = end
