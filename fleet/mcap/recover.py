"""`fleet recover`: what is left of a cut or damaged log, as a clean file with an index.

Chunk by chunk, so that a whole log comes out as the same bytes. The metadata record `recovery` lists the missing parts.
Its `gaps` are the numbers of the messages, from 0, that follow a gap.
"""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Channel, Header, Metadata, Schema

from fleet.errors import FleetError
from fleet.mcap.other import Recovered
from fleet.mcap.reader import GAPS, LOST, RECOVERY, OnProgress, describe_loss, log_files, log_path, open_any
from fleet.mcap.records import LIBRARY, MAGIC, Block, Message
from fleet.mcap.salvage import ChunkEnd, Item, Salvage
from fleet.mcap.writer import McapWriter
from netem.whole_file import whole_file

_YEAR_1973_S = 1e8


def recover(path: Path, out: Path | None = None, on_progress: OnProgress = lambda _: None) -> Recovered:
    """Write what can be read of a log to `out`, by default `<log>.recovered.mcap` beside it; nothing if nothing can.
    Raises LogReadError if the file cannot be opened; FleetError if `out` exists or cannot be written.
    """
    path = log_path(path)
    if path.is_dir():
        raise FleetError(f"{path} is a bag of several files: recover each by itself, such as {log_files(path)[0]}")
    out = out or path.with_name(f"{path.stem}.recovered.mcap")
    if out.exists():
        raise FleetError(f"{out} exists already: choose another place with -o OUT")
    with open_any(path) as source:
        magic = source.read(len(MAGIC)) == MAGIC
        try:
            with whole_file(out) as part:
                with part.open("wb") as target:
                    found = _copy(path, out, Salvage(source, beyond=True, on_progress=on_progress), target, magic)
                if found.nothing:
                    part.unlink()
        except OSError as error:
            raise FleetError(f"cannot write {out}: {error.strerror or error}") from error
    return found


def _copy(path: Path, out: Path, salvage: Salvage, target: IO[bytes], magic: bool) -> Recovered:
    found = Recovered(path, out)
    copy = Copy(target, found)
    known = False
    gaps: list[int] = []
    damaged = 0
    for item in salvage:
        if not isinstance(item, Block):
            copy.take(item)
            continue
        if len(salvage.damage) > damaged:
            gaps.append(found.messages)
            damaged = len(salvage.damage)
        for message in item.messages():
            if not known and not copy.knows_channel(message):
                known = True  # the chunk that declared it is damaged: the index repeats it
                for declaration in salvage.declarations():
                    copy.take(declaration)
            copy.message(message)
    found.places = [str(damage) for damage in salvage.damage]
    gone = [*(["the first bytes (they are not those of MCAP)"] if not magic else []), describe_loss(salvage)]
    if found.undeclared:
        gone.append(f"{found.undeclared} messages on channels whose declaration is gone")
    found.lost = "; ".join(part for part in gone if part)
    found.rebuilt = not salvage.indexed
    copy.finish({
        LOST: found.lost,
        "messages": str(found.messages),
        "until_ns": str(copy.last_ns),
        GAPS: " ".join(str(number) for number in gaps),
    } if found.lost else {})  # fmt: skip
    return found


class Copy:
    """Writes items as they come."""

    def __init__(self, target: IO[bytes], found: Recovered) -> None:
        self._target = target
        self._writer: McapWriter | None = None
        self._found = found
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self.last_ns = 0

    def take(self, item: Item) -> None:
        """Write one item; what refers to something that is gone is counted."""
        writer = self._started(item)
        match item:
            case ChunkEnd():
                writer.flush()
            case Schema() if item.id not in self._schemas:
                self._schemas[item.id] = writer.schema(item.name, item.encoding, item.data)
            case Channel() if item.id not in self._channels and item.schema_id in self._schemas:
                self._channels[item.id] = writer.channel(
                    item.topic, item.message_encoding, self._schemas[item.schema_id], item.metadata
                )
            case Attachment():
                writer.attachment(item)
            case Metadata():
                writer.metadata(item.name, item.metadata)
            case _:
                pass

    def message(self, message: Message) -> None:
        """Write a message, or count it if nothing is known of its channel."""
        writer = self._started()
        channel = self._channels.get(message.channel)
        if channel is None:
            self._found.undeclared += 1
            return
        writer.message(channel, message.log_ns, message.publish_ns, message.sequence, message.data)
        self._found.messages += 1
        self.last_ns = max(self.last_ns, message.log_ns)
        self._found.until_s = self.last_ns / 1e9

    def knows_channel(self, message: Message) -> bool:
        """Whether its channel is known."""
        return message.channel in self._channels

    def finish(self, recovery: dict[str, str]) -> None:
        """Write the index."""
        if self._writer is None:
            return
        if recovery:
            self._writer.metadata(RECOVERY, recovery)
        self._writer.finish()

    def _started(self, item: Item | None = None) -> McapWriter:
        if self._writer is None:
            header = item if isinstance(item, Header) else Header("", LIBRARY)
            self._writer = McapWriter(self._target, **asdict(header))
        return self._writer


def recovery_text(found: Recovered) -> str:
    if found.nothing:
        return f"{found.path}: nothing can be recovered{f': {found.lost}' if found.lost else ', it holds no message'}"
    until = f"t = {found.until_s:g} s"
    if found.until_s > _YEAR_1973_S:  # recorded traffic has dates
        until = f"{datetime.fromtimestamp(found.until_s, UTC):%Y-%m-%d %H:%M:%S} UTC"
    text = f"{found.out}: {found.messages} messages up to {until}"
    if found.lost:
        return f"{text}; LOST: {found.lost}"
    return f"{text}; nothing is lost{', the index was rebuilt' if found.rebuilt else ''}"
