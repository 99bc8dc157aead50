"""Writing an MCAP file: chunks and their indexes packed here, every other record by `mcap.records`.

The bytes are the same as those of `mcap.writer.Writer` (a test compares them). That writer takes some thirty calls for
a message; here it is one `struct` call and two appends, or less: a batch comes framed.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from struct import Struct
from typing import IO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
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

from fleet.logs.batch import HEAD, MESSAGE, STAMP_BYTES, Batch
from fleet.logs.chunk_index import ChunkEntries
from fleet.logs.records import MAGIC

CHUNK_BYTES = 1024 * 1024  # a chunk ends when it is longer
_HEAD = HEAD.pack
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
        self._entries = ChunkEntries()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[bytes] = []  # their records in the summary
        self._times: list[int] = []  # the earliest and the latest of each chunk
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
        self._entries.single += (channel, log_ns, len(chunk))
        chunk += _HEAD(MESSAGE, STAMP_BYTES + len(data), channel, sequence, log_ns, publish_ns) + data
        if len(chunk) > CHUNK_BYTES:
            self._end_chunk()

    def batch(self, batch: Batch) -> None:
        """Write messages that are framed already; chunks end where they would if the messages came one by one."""
        bounds, records = batch.bounds, batch.records.data
        first, begin, end = 0, 0, len(records)
        while begin < end:
            room = begin + CHUNK_BYTES - len(self._chunk)
            full = end > room
            last = max(first + 1, int(np.searchsorted(bounds, room, side="right"))) if full else len(bounds) - 1
            upto = int(bounds[last])
            places = bounds[first:last] + (len(self._chunk) - begin)
            self._entries.add(batch.at_ns, batch.channels[first:last], places)
            self._chunk += records[begin:upto]
            first, begin = last, upto
            if full:
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
        for opcode, group in (
            (Opcode.SCHEMA, _packed(self._schemas)),
            (Opcode.CHANNEL, _packed(self._channels)),
            (Opcode.STATISTICS, _packed([self._statistics()])),
            (Opcode.CHUNK_INDEX, b"".join(self._chunks)),
            (Opcode.ATTACHMENT_INDEX, _packed(self._attachments)),
            (Opcode.METADATA_INDEX, _packed(self._metadata)),
        ):
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
        if not self._entries:
            return
        indexes = self._entries.indexes()
        data, size = zstandard.compress(self._chunk), len(self._chunk)
        chunk = Chunk("zstd", data, indexes.last_ns, indexes.first_ns, zlib.crc32(self._chunk), size)
        offset, length = self._write(chunk)
        self._target.write(indexes.data)
        self._chunks.append(indexes.chunk_index(offset, length, len(data), size))
        self._times += (indexes.first_ns, indexes.last_ns)
        for channel, count in indexes.counts:
            self._counts[channel] = self._counts.get(channel, 0) + count
        self._chunk.clear()
        self._entries.clear()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=min(self._times, default=0),
            message_end_time=max(self._times, default=0),
            schema_count=len(self._schemas),
        )


def _packed(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
