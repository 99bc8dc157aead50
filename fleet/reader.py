"""Reading a log, whole or cut: in file order, every complete chunk, and a word on what is missing."""

from __future__ import annotations

import hashlib
import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, NamedTuple

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, DataEnd, Footer, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader
from zstandard import ZstdError

from fleet.errors import FleetError

_TIMES = struct.Struct("<QQII").pack
MAGIC = b"\x89MCAP0\r\n"


class LogReadError(FleetError):
    """There is no log to read."""


class Record(NamedTuple):
    """One message of a log, times in ns of sim time."""

    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass(slots=True)
class LogReader:
    """Iterates the messages of a log once; what else it holds is there when the iteration is over."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    missing: str = ""  # why the file is not whole; "" if it is

    def __iter__(self) -> Iterator[Record]:
        """Every message of every complete chunk, in file order.

        Raises:
            LogReadError: the file cannot be opened or is no MCAP file.
        """
        with open_log(self.path) as file:
            yield from self._records(file)

    def _records(self, file: IO[bytes]) -> Iterator[Record]:
        whole = False
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                match record:
                    case Message():
                        channel = self.channels[record.channel_id]
                        yield Record(channel.topic, record.log_time, record.publish_time, record.sequence, record.data)
                    case Schema():
                        self.schemas[record.id] = record
                    case Channel():
                        self.channels[record.id] = record
                    case Metadata():
                        self.metadata[record.name] = dict(record.metadata)
                    case Attachment():
                        self.attachments[record.name] = record.data
                    case DataEnd():
                        whole = True
                    case Footer():
                        return
            self.missing = "the index is missing" if whole else _CUT
        # mcap raises whatever its parser stumbles over: a cut or damaged file is any of these.
        except (CRCValidationError, ZstdError):
            self.missing = "a chunk is damaged (a flipped bit, for instance); reading stopped before it"
        except (McapError, struct.error, ValueError, KeyError, EOFError, MemoryError, OverflowError) as error:
            self.missing = f"{_CUT} ({type(error).__name__})" if not whole else "the index is missing or damaged"


_CUT = "the file is cut: the run was killed while it was written, or it is still going on"


def digest_part(topic: bytes, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> bytes:
    """What one message adds to a log's digest."""
    return topic + _TIMES(log_ns, publish_ns, sequence, len(data)) + data


def digest(path: Path) -> str:
    """SHA-256 over the ordered messages (topic, times, sequence, data), as `fleet run` prints it.

    Raises:
        LogReadError: see `LogReader`.
    """
    total = hashlib.sha256()
    for r in LogReader(path):
        total.update(digest_part(r.topic.encode(), r.log_ns, r.publish_ns, r.sequence, r.data))
    return total.hexdigest()


def log_path(path: Path) -> Path:
    """A log file, given itself or its run directory."""
    return path / "run.mcap" if path.is_dir() else path


def open_log(path: Path) -> IO[bytes]:
    """The file, at its beginning.

    Raises:
        LogReadError: it cannot be opened or is no MCAP file.
    """
    try:
        file = path.open("rb")
    except OSError as error:
        raise LogReadError(f"cannot read {path}: {error.strerror}") from error
    start = file.read(len(MAGIC))
    if start != MAGIC:
        file.close()
        what = "it is empty" if not start else "it does not begin with MCAP's magic bytes"
        raise LogReadError(f"{path} is no MCAP log: {what}")
    file.seek(0, io.SEEK_SET)
    return file
