"""The MCAP file of a run and the digest over its ordered messages; with `log: none` there is only the digest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from mcap.records import Attachment

from fleet.errors import FleetError
from fleet.logs.schemas import Schema
from fleet.mcap.batch import Batch
from fleet.mcap.digest import Digest
from fleet.mcap.writer import McapWriter
from fleet.recorder.metrics import VehicleError
from fleet.scenario.sections.timeline import Event
from netem.wire.messages import Command, Fate, Frame

SECOND_NS = 1_000_000_000


class LogError(FleetError):
    """The log cannot be written: for example the disk is full, or the directory is not writable."""

    status = 3


class LogFile:
    """A new MCAP file; `LogWriter` writes its encoded messages into it. `close` writes the end of the file; without it
    the file is truncated but readable. What writes raises LogError when the operating system reports an error.
    """

    def __init__(self, path: Path) -> None:
        """Create the file. Raises LogError if it exists already, or cannot be created."""
        self.path = path
        self.messages = 0
        self._digest = Digest()
        self._flush_ns = SECOND_NS  # when the next second begins
        self._topics: dict[int, bytes] = {}
        self._schemas: dict[str, int] = {}
        with self._refused():
            self._file: IO[bytes] = path.open("xb")
            self._writer = McapWriter(self._file)

    @property
    def digest(self) -> str:
        """SHA-256 over (topic, log_time, publish_time, sequence, data) of every message so far, in hexadecimal."""
        return self._digest.hexdigest()

    @property
    def size(self) -> int:
        """The present size of the file [bytes]; 0 if it cannot be found."""
        try:
            return self.path.stat().st_size
        except OSError:
            return 0

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        with self._refused():
            self._writer.attachment(Attachment(0, 0, name, media_type, data))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write metadata, and pass everything written until now to the operating system, so that the file of a run that
        is killed within its first second holds at least the scenario.
        """
        with self._refused():
            self._writer.metadata(name, values)
            self._file.flush()

    def channel(self, topic: str, schema: Schema) -> int:
        """Declare a topic, and return the number of its channel, which `message` needs."""
        data = schema.name, "protobuf", schema.descriptor_set
        return self.other_channel(topic, "protobuf", data, {"units": schema.units})

    def other_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes] | None, metadata: Mapping[str, str]
    ) -> int:
        """Declare a topic with messages of others. `schema`: its name, encoding and data; None: it has none."""
        with self._refused():
            if schema is not None and schema[0] not in self._schemas:
                self._schemas[schema[0]] = self._writer.schema(*schema)
            known = 0 if schema is None else self._schemas[schema[0]]
            number = self._writer.channel(topic, encoding, known, dict(metadata))
        self._topics[number] = topic.encode()
        return number

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Write a message to a channel that `channel` declared; both times in ns of simulated time."""
        try:  # not `_refused`: it takes more time than the digest of the message
            self._writer.message(channel, log_ns, publish_ns, sequence, data)
        except OSError as error:
            raise self._error(error) from error
        self._digest.add(self._topics[channel], log_ns, publish_ns, sequence, data)
        self.messages += 1

    def batch(self, batch: Batch) -> None:
        """Write messages that have their times in common."""
        with self._refused():
            self._writer.batch(batch)
        self._digest.add_batch(batch.digested.tobytes())
        self.messages += len(batch.channels)

    def flush(self, at_ns: int) -> None:
        """End the chunk if a new second of simulated time has begun at `at_ns` [ns].

        The borders of the chunks change the bytes of the file, so they depend on simulated time only.
        """
        if at_ns >= self._flush_ns:
            self._flush_ns = (at_ns // SECOND_NS + 1) * SECOND_NS
            with self._refused():
                self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file. Raises LogError if the rest of the file cannot be written."""
        with self._refused():
            self._writer.finish()
            self._file.close()

    def abandon(self) -> None:
        """Close the file after a write failed; chunks that were written before stay readable. Raises nothing."""
        try:
            self._file.close()
        except OSError:
            # The rest of the buffer cannot be written either; the first error is already reported.
            return

    @contextmanager
    def _refused(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._error(error) from error

    def _error(self, error: OSError) -> LogError:
        return LogError(f"cannot write the log {self.path}: {error.strerror or error}")


class NoLog:
    """Takes the messages of a log as `LogFile` does, and counts and digests them. Its memory does not grow."""

    size = 0  # bytes

    def __init__(self) -> None:
        self.messages = 0
        self._digest = Digest()
        self._topics: list[bytes] = []

    @property
    def digest(self) -> str:
        """The digest that a log would have: see `LogFile`."""
        return self._digest.hexdigest()

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Nothing to do: the digest is of messages."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Nothing to do: the digest is of messages."""

    def channel(self, topic: str, schema: Schema) -> int:
        self._topics.append(topic.encode())
        return len(self._topics) - 1

    def other_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes] | None, metadata: Mapping[str, str]
    ) -> int:
        self._topics.append(topic.encode())
        return len(self._topics) - 1

    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        """Count and digest a message; both times in ns of simulated time."""
        self._digest.add(self._topics[channel], log_ns, publish_ns, sequence, data)
        self.messages += 1

    def batch(self, batch: Batch) -> None:
        """Count and digest messages that have their times in common."""
        self._digest.add_batch(batch.digested.tobytes())
        self.messages += len(batch.channels)

    def flush(self, at_ns: int) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to do."""

    def abandon(self) -> None:
        """Nothing to do."""


class NoDigest(NoLog):
    """No log and no digest, for a run of which only the verdicts count: a digest takes as long as the messages of a
    log. The journal writes to it in place of a `LogWriter`.
    """

    digest = ""

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        """Nothing to do."""

    def packet(self, fate: Fate) -> None:
        """Nothing to do."""

    def event(self, event: Event) -> None:
        """Nothing to do."""
