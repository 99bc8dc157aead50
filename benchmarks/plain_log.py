"""A log as the libraries alone make it, message by message: what our recorder is measured against, and tested."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from struct import pack

from mcap.writer import CompressionType, Writer

from fleet.logs.schemas import Schema
from fleet.mcap.batch import Batch
from fleet.mcap.writer import CHUNK_BYTES
from fleet.recorder.log_file import SECOND_NS


class PlainLog:
    """Takes the messages of a log as `LogFile` does, for `mcap.writer.Writer` and one hash; the result is the same."""

    def __init__(self, path: Path, chunk_bytes: int = CHUNK_BYTES) -> None:
        """Create the file; chunks end when they are longer than `chunk_bytes`."""
        self.messages = 0
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start("", "uuv-fleet")
        self._hash = hashlib.sha256()
        self._topics: dict[int, bytes] = {}
        self._schemas: dict[str, int] = {}
        self._second = 0

    @property
    def digest(self) -> str:
        """See `LogFile.digest`."""
        return self._hash.hexdigest()

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        self._writer.add_attachment(0, 0, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata."""
        self._writer.add_metadata(name, dict(values))

    def channel(self, topic: str, schema: Schema) -> int:
        """Declare a topic, and return the number of its channel."""
        if schema.name not in self._schemas:
            number = self._writer.register_schema(schema.name, "protobuf", schema.descriptor_set)
            self._schemas[schema.name] = number
        number = self._writer.register_channel(topic, "protobuf", self._schemas[schema.name], {"units": schema.units})
        self._topics[number] = topic.encode()
        return number

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Write a message; both times in ns of simulated time."""
        self._writer.add_message(channel, log_ns, data, publish_ns, sequence)
        self._hash.update(self._topics[channel] + pack("<QQII", log_ns, publish_ns, sequence, len(data)) + data)
        self.messages += 1

    def batch(self, batch: Batch) -> None:
        """Write messages that have their times in common."""
        for message in batch.messages():
            self.message(*message)

    def flush(self, at_ns: int) -> None:
        """End the chunk if a new second of simulated time has begun."""
        if at_ns // SECOND_NS > self._second:
            self._second = at_ns // SECOND_NS
            self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()
