"""Writing an MCAP file: chunks and their indexes packed here, every other record by `mcap.records`.

The bytes are those that `mcap.writer.Writer` writes (a test compares them). That writer takes some thirty calls for
a message; here it is one `struct` call and two appends.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from struct import Struct, pack
from typing import IO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from fleet.logs.records import MAGIC

CHUNK_BYTES = 1024 * 1024  # a chunk ends when it is longer
_MESSAGE, _INDEX = int(Opcode.MESSAGE), int(Opcode.MESSAGE_INDEX)
_STAMP = 22  # bytes of a message's channel, sequence and times
_HEAD = Struct("<BQHIQQ").pack  # opcode, length of the rest, channel, sequence, log time, publish time
_FOOTER = Struct("<BQQQ").pack  # opcode, length of the rest, where the summary and its offsets begin


class McapWriter:
    """Writes a compressed, indexed file; chunks end after `CHUNK_BYTES`, or when `flush` is called.

    Every method raises OSError as the target does.
    """

    def __init__(self, target: IO[bytes], profile: str = "", library: str = "uuv-fleet") -> None:
        """Write the header.

        Args:
            target: an empty file; the caller closes it.
            library: what is named as the writer of the file; by default without a version, which would change bytes.
        """
        self._target = target
        self._chunk = bytearray()
        self._entries: dict[int, list[int]] = {}  # channel -> log time and place in the chunk of message after message
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}  # messages per channel, of the chunks that are written
        target.write(MAGIC)
        self._write(Header(profile, library))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a schema, and return its number."""
        self._schemas.append(Schema(data=data, encoding=encoding, id=len(self._schemas) + 1, name=name))
        self._chunk += _packed([self._schemas[-1]])
        self._end_long_chunk()
        return self._schemas[-1].id

    def channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Declare a channel with messages of a schema (0: of none), and return its number."""
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, encoding, dict(metadata), schema))
        self._chunk += _packed([self._channels[-1]])
        self._end_long_chunk()
        return number

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Write a message; both times in ns."""
        chunk = self._chunk
        try:
            self._entries[channel] += (log_ns, len(chunk))
        except KeyError:
            self._entries[channel] = [log_ns, len(chunk)]
        chunk += _HEAD(_MESSAGE, _STAMP + len(data), channel, sequence, log_ns, publish_ns) + data
        if len(chunk) > CHUNK_BYTES:
            self._end_chunk()

    def attachment(self, a: Attachment) -> None:
        """Write an attachment, before the messages of the chunk that is not ended yet."""
        place = self._write(a)
        self._attachments.append(AttachmentIndex(*place, a.log_time, a.create_time, len(a.data), a.name, a.media_type))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata, before the messages of the chunk that is not ended yet."""
        self._metadata.append(MetadataIndex(*self._write(Metadata(name, dict(values))), name))

    def flush(self) -> None:
        """End the chunk, unless it has no messages, and pass everything to the operating system."""
        self._end_chunk()
        self._target.flush()

    def finish(self) -> None:
        """Write the index and the end of the file."""
        self._end_chunk()
        self._write(DataEnd(0))
        begin = self._target.tell()
        summary = bytearray()
        offsets: list[SummaryOffset] = []
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            group = _packed(records)
            offsets.append(SummaryOffset(opcode, begin + len(summary), len(group)))
            summary += group
        offset_begin = begin + len(summary)
        summary += _packed(offsets)
        crc = zlib.crc32(_FOOTER(Opcode.FOOTER, 20, begin, offset_begin), zlib.crc32(summary))
        self._target.write(summary)
        self._write(Footer(begin, offset_begin, crc))
        self._target.write(MAGIC)

    def _write(self, record: McapRecord) -> tuple[int, int]:
        """Write a record that is in no chunk; where it begins, and its length."""
        offset = self._target.tell()
        data = _packed([record])
        self._target.write(data)
        return offset, len(data)

    def _end_long_chunk(self) -> None:
        if len(self._chunk) > CHUNK_BYTES:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk and its indexes, unless it has no messages."""
        entries = self._entries
        if not entries:
            return
        first = min(min(flat[::2]) for flat in entries.values())
        last = max(max(flat[::2]) for flat in entries.values())
        data = zstandard.compress(self._chunk)
        size = len(self._chunk)
        offset, length = self._write(Chunk("zstd", data, last, first, zlib.crc32(self._chunk), size))
        index = bytearray()
        offsets: dict[int, int] = {}
        for channel, flat in entries.items():
            offsets[channel] = offset + length + len(index)
            index += pack(f"<BQHI{len(flat)}Q", _INDEX, 6 + 8 * len(flat), channel, 8 * len(flat), *flat)
            self._counts[channel] = self._counts.get(channel, 0) + len(flat) // 2
        self._target.write(index)
        self._chunks.append(ChunkIndex(length, offset, "zstd", len(data), last, len(index), offsets, first, size))
        self._chunk.clear()
        entries.clear()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            schema_count=len(self._schemas),
        )


def _packed(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
