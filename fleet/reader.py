"""Reading a log, whole or cut: in file order, every complete chunk, and a word on what is missing."""

from __future__ import annotations

import hashlib
import io
import stat
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, NamedTuple

from mcap.records import Attachment, Channel, Metadata, Schema

from fleet.errors import FleetError
from fleet.salvage import MAGIC, Damage, Item, Message, Salvage

CLOCK, REAL = "clock", "real"  # metadata of a run without lockstep: it would not come out the same again
RECOVERY = "recovery"  # metadata of a file that `fleet recover` wrote
LOST = "lost"  # in it: what is gone, in words
GAPS = "gaps"  # in it: numbers of the messages before which something is gone
_TIMES = struct.Struct("<QQII").pack


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
    """Iterates the messages of a log once; what else it holds is there when the iteration is over.

    It stops at the first damaged place, so that what it yields is how the run began, without a gap; `fleet.recover`
    goes on behind.
    """

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    missing: str = ""  # why the file is not whole; "" if it is
    cut: bool = False  # the file has no end: what follows its last complete chunk was never written
    damage: list[Damage] = field(default_factory=list)

    def __iter__(self) -> Iterator[Record]:
        """Every message of every complete chunk, in file order.

        Raises:
            LogReadError: the file cannot be opened or is no MCAP file.
        """
        with open_file(self.path) as file:
            salvage = Salvage(file)
            topics: dict[int, str] = {}
            for item in salvage:
                if isinstance(item, Message):
                    topic = topics.get(item.channel)
                    if topic is None:
                        salvage.damage.append(
                            Damage(file.tell(), f"a message on the undeclared channel {item.channel}")
                        )
                        break
                    yield Record(topic, item.log_ns, item.publish_ns, item.sequence, item.data)
                else:
                    self._keep(item, topics)
            self.cut, self.damage = salvage.cut, salvage.damage
            self.missing = missing(salvage)
            if not self.missing and (gone := self.metadata.get(RECOVERY, {}).get(LOST)):
                self.missing = f"it was recovered from a damaged file, of which this is lost: {gone}"

    def _keep(self, item: Item, topics: dict[int, str]) -> None:
        match item:
            case Schema():
                self.schemas[item.id] = item
            case Channel():
                self.channels[item.id] = item
                topics[item.id] = item.topic
            case Metadata():
                self.metadata[item.name] = dict(item.metadata)
            case Attachment():
                self.attachments[item.name] = item.data


def missing(salvage: Salvage) -> str:
    """What a file lacks, in words; "" if it is whole."""
    if salvage.damage:
        return f"{salvage.damage[0]}; reading stopped before it" if not salvage.beyond else lost(salvage)
    if salvage.cut:
        return "the file is cut: the run was killed while it was written, or it is still going on"
    if salvage.stated is not None and salvage.indexed and salvage.stated != salvage.messages:
        return f"{salvage.messages} of {salvage.stated} messages: whole chunks are gone"
    return "" if salvage.indexed else "the index is missing or damaged"


def lost(salvage: Salvage) -> str:
    """What is gone of a file that was read beyond its damage; "" if no message is."""
    places = [str(damage) for damage in salvage.damage]
    if salvage.cut or not salvage.ended:
        places.append("the end: the file is cut")
    elif salvage.indexed and salvage.stated is not None:
        more = salvage.stated - salvage.messages - sum(damage.messages for damage in salvage.damage)
        places += [f"{more} more of {salvage.stated} messages"] if more > 0 else []
    return "; ".join(places)


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


def open_file(path: Path) -> IO[bytes]:
    """A log file, for reading.

    Raises:
        LogReadError: it cannot be opened or does not begin as an MCAP file does.
    """
    file = open_any(path)
    start = file.read(len(MAGIC))
    if start != MAGIC:
        file.close()
        what = "it is empty" if not start else "it does not begin with MCAP's magic bytes"
        raise LogReadError(f"{path} is no MCAP log: {what}")
    file.seek(0, io.SEEK_SET)
    return file


def open_any(path: Path) -> IO[bytes]:
    """Any file, for reading.

    Raises:
        LogReadError: it cannot be opened.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a pipe would be waited for
            raise LogReadError(f"cannot read {path}: it is no file")
        return path.open("rb")
    except OSError as error:
        raise LogReadError(f"cannot read {path}: {error.strerror}") from error
