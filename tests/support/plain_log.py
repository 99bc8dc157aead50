"""A log as the libraries alone make it, message by message: what the recorder's bytes and digest have to be."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from mcap.writer import CompressionType, Writer

from fleet.logs.batch import Batch
from fleet.logs.schemas import Column, Schema, head

Entry = tuple[str, int, int, int, bytes]  # topic, log time, publish time, sequence, data


def encoded(columns: Iterable[Column], values: Sequence[float]) -> bytes:
    """A message of doubles field by field, zeros too, as all of the log's are."""
    data, rest = b"", list(values)
    for number, column in enumerate(columns, start=1):
        width = column.width or 1
        data += head(number, column.width or None) + struct.pack(f"<{width}d", *rest[:width])
        del rest[:width]
    assert not rest
    return data


class PlainLog:
    """A sink of the log writer: `mcap.writer.Writer`, one hash, and a list of all messages."""

    def __init__(self, path: Path, chunk_bytes: int) -> None:
        """`chunk_bytes`: chunks end when they are longer."""
        self.entries: list[Entry] = []
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start("", "uuv-fleet")
        self._hash = hashlib.sha256()
        self._topics: dict[int, str] = {}
        self._schemas: dict[str, int] = {}
        self._second = 0

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        self._writer.add_attachment(0, 0, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._writer.add_metadata(name, dict(values))

    def channel(self, topic: str, schema: Schema) -> int:
        if schema.name not in self._schemas:
            number = self._writer.register_schema(schema.name, "protobuf", schema.descriptor_set)
            self._schemas[schema.name] = number
        number = self._writer.register_channel(topic, "protobuf", self._schemas[schema.name], {"units": schema.units})
        self._topics[number] = topic
        return number

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        self._writer.add_message(channel, log_ns, data, publish_ns, sequence)
        topic = self._topics[channel]
        self._hash.update(topic.encode() + struct.pack("<QQII", log_ns, publish_ns, sequence, len(data)) + data)
        self.entries.append((topic, log_ns, publish_ns, sequence, data))

    def batch(self, batch: Batch) -> None:
        for message in batch.messages():
            self.message(*message)

    def flush(self, at_ns: int) -> None:
        if at_ns // 10**9 > self._second:
            self._second = at_ns // 10**9
            self._writer.flush()

    def close(self) -> None:
        self._writer.finish()
        self._file.close()

    def abandon(self) -> None:
        self._file.close()
