"""The MCAP file of a run, and the digest over its ordered messages."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from mcap.writer import CompressionType, Writer

from fleet.errors import FleetError
from fleet.logs.reader import digest_part
from fleet.logs.schemas import Schema

SECOND_NS = 1_000_000_000


class LogError(FleetError):
    """The log cannot be written: the disk is full, or the place is not writable."""

    status = 3


class LogFile:
    """What `LogWriter` encodes, written to a new MCAP file.

    `close` finishes the file; without it the file is cut but readable.
    """

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            LogError: it exists already, or cannot be created.
        """
        self.path = path
        self.messages = 0
        self._digest = hashlib.sha256()
        self._flushed_s = 0
        self._topics: dict[int, bytes] = {}
        self._schemas: dict[str, int] = {}
        with self._refused():
            self._file: IO[bytes] = path.open("xb")
            # Without `library` the mcap version would stand in the file, and bytes would differ between versions.
            self._writer = Writer(self._file, compression=CompressionType.ZSTD)
            self._writer.start(profile="", library="uuv-fleet")

    @property
    def digest(self) -> str:
        """SHA-256 over (topic, log_time, publish_time, sequence, data) of every message so far."""
        return self._digest.hexdigest()

    @property
    def size(self) -> int:
        """Bytes of the file as it is now; 0 if it was removed."""
        try:
            return self.path.stat().st_size
        except OSError:
            return 0

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        with self._refused():
            self._writer.add_attachment(0, 0, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata, and hand it to the operating system with everything before it.

        A run that is killed within its first second thus leaves its scenario at least.
        """
        with self._refused():
            self._writer.add_metadata(name, dict(values))
            self._file.flush()

    def channel(self, topic: str, schema: Schema) -> int:
        """Declare a topic; returns the number of its channel."""
        with self._refused():
            if schema.name not in self._schemas:
                self._schemas[schema.name] = self._writer.register_schema(
                    schema.name, "protobuf", schema.descriptor_set
                )
            number = self._writer.register_channel(
                topic, "protobuf", self._schemas[schema.name], {"units": schema.units}
            )
        self._topics[number] = topic.encode()
        return number

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Write a message; both times in ns of simulated time."""
        try:  # not `_refused`, which costs more than the message's digest
            self._writer.add_message(channel, log_ns, data, publish_ns, sequence)
        except OSError as error:
            raise self._error(error) from error
        self._digest.update(digest_part(self._topics[channel], log_ns, publish_ns, sequence, data))
        self.messages += 1

    def flush(self, at_ns: int) -> None:
        """End a chunk for every second of simulated time: chunk borders are part of the file's bytes."""
        second = at_ns // SECOND_NS
        if second > self._flushed_s:
            self._flushed_s = second
            with self._refused():
                self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close the file.

        Raises:
            LogError: the rest cannot be written.
        """
        with self._refused():
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()

    def abandon(self) -> None:
        """Close the file after a write failed; what was flushed before stays readable."""
        try:
            self._file.close()
        except OSError:
            # The buffer could not be written either: the error is already on its way to the user.
            return

    @contextmanager
    def _refused(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._error(error) from error

    def _error(self, error: OSError) -> LogError:
        return LogError(f"cannot write the log {self.path}: {error.strerror or error}")
