"""Read a log, complete or truncated: all complete chunks in file order, and a text that says what is missing."""

from __future__ import annotations

import io
import stat
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath
from typing import IO, Any, NamedTuple, TypeVar

import numpy as np
import yaml
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from fleet.errors import FleetError, printable
from fleet.mcap.digest import Digest
from fleet.mcap.other import as_mcap
from fleet.mcap.records import MAGIC, Block, renumbered, together
from fleet.mcap.salvage import Damage, Item, Salvage
from fleet.mcap.traffic import is_attachment
from netem.files import read_file
from netem.limits import LOG_REST, SCENARIO

RECOVERY = "recovery"  # name of the metadata record in a file that `fleet recover` wrote
LOST = "lost"  # key in this record: text that says what is lost
GAPS = "gaps"  # key in this record: numbers (from 0) of the messages before which data is lost
_YAML = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C it takes a twentieth of the time
_WHAT_IT_IS = (
    "a log is an MCAP file, or the directory of a run, such as runs/latest, or of a bag of ROS 2; fleet ls lists runs"
)
_ENTRY = 256  # estimated memory [bytes] of one entry of metadata, in addition to its text
OnProgress = Callable[[float], None]  # progress callback: gets the fraction of the file that was read, 0 to 1


class LogReadError(FleetError):
    """The file is no log that can be read, or what is asked of it is not in it."""


D = TypeVar("D", Schema, Channel)


class Record(NamedTuple):
    """One message of a log; times in ns of simulated time."""

    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass(slots=True)
class LogReader:
    """Iterates over the messages of a log, once; the fields below are complete after that. It stops at the first
    damaged place, so the messages are the beginning of the run without a gap (`fleet.mcap.recover` reads on). The files
    of a split bag are read one after the other, and what they declare is numbered as if it were in one file.
    """

    path: Path
    on_progress: OnProgress = lambda _: None
    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    last_ns: int = -1  # latest log time of a message so far [ns]; -1: no message
    missing: str = ""  # why the file is not complete; "" if it is complete
    cut: bool = False  # the file is truncated: it stops within a record, or before its end was written
    damage: list[Damage] = field(default_factory=list)
    file: Path = Path()  # the file that is being read, if the log has several
    numbers: dict[Path, dict[int, int]] = field(default_factory=dict)  # of channels, by their numbers in a file
    _known: dict[tuple[Any, ...], int] = field(default_factory=dict, init=False)  # numbers of what was declared
    _kept: dict[tuple[type, int | str], int] = field(default_factory=dict, init=False)  # size of each [bytes]
    _total: int = field(default=0, init=False)  # sum of these sizes [bytes]
    _by_topic: dict[str, Channel] = field(default_factory=dict, init=False)

    def __iter__(self) -> Iterator[Record]:
        """Every message of every complete chunk, in file order. Raises LogReadError if the file cannot be opened, is no
        MCAP file, or declares more than LOG_REST.bytes bytes.
        """
        for block in self.blocks():
            yield from self._records(block)

    def of(self, topics: Collection[str]) -> Iterator[Record]:
        """Only the messages of these topics; the others are skipped quickly. Raises the same errors as iteration."""
        for block in self.blocks():
            yield from self.select(block, topics)

    def select(self, block: Block, topics: Collection[str]) -> Iterator[Record]:
        """The messages of these topics in one block."""
        some = [number for number in np.unique(block.channel).tolist() if self.channels[number].topic in topics]
        if some:
            yield from self._records(block.take(np.isin(block.channel, np.array(some, np.uint16))))

    def _records(self, block: Block) -> Iterator[Record]:
        topics: dict[int, str] = {}
        for channel, sequence, log_ns, publish_ns, data in block.messages():
            topic = topics.get(channel)
            if topic is None:
                topic = topics[channel] = self.channels[channel].topic
            yield Record(topic, log_ns, publish_ns, sequence, data)

    def blocks(self) -> Iterator[Block]:
        """The same messages as iteration, in blocks; the channel of each is declared. Raises the same errors."""
        files = log_files(self.path)
        for done, path in enumerate(files):
            yield from self._blocks(path, partial(self._tell, done, len(files)))
            if self.missing and len(files) > 1:
                self.missing = f"{path.name}: {self.missing}"
            if self.missing:
                return

    def _tell(self, done: int, files: int, share: float) -> None:
        self.on_progress((done + share) / files)

    def _blocks(self, path: Path, on_progress: OnProgress) -> Iterator[Block]:
        self.file = path
        numbers: dict[int, int] = {}
        self.numbers[path] = numbers
        schemas: dict[int, int] = {}
        with open_file(path) as file:
            salvage = Salvage(file, on_progress=on_progress)
            for item in salvage:
                match item:
                    case Schema():
                        self._keep(self._numbered(item, schemas, self.schemas))
                    case Channel():
                        schema = schemas.get(item.schema_id, item.schema_id)
                        self._keep(self._numbered(replace(item, schema_id=schema), numbers, self.channels))
                    case Block():
                        known = np.isin(item.channel, np.fromiter(numbers, np.uint16, len(numbers)))
                        first = len(item) if known.all() else int(known.argmin())
                        if first:
                            self.last_ns = max(self.last_ns, int(item.log_ns[:first].max()))
                            yield renumbered(item if first == len(item) else item.take(np.arange(first)), numbers)
                        if first == len(item):
                            continue
                        channel = int(item.channel[first])
                        salvage.damage.append(Damage(item.offset, f"a message on the undeclared channel {channel}"))
                        break
                    case _:
                        self._keep(item)
            self.cut, self.damage = salvage.cut, salvage.damage
            self.missing = missing(salvage)
            if not self.missing and (gone := self.metadata.get(RECOVERY, {}).get(LOST)):
                self.missing = f"it was recovered from a damaged file, of which this is lost: {gone}"

    def _numbered(self, item: D, numbers: dict[int, int], declared: Mapping[int, D]) -> D:
        """A declaration, with another number if an earlier file of a bag has used its own for something else."""
        what = type(item), *(tuple(v.items()) if isinstance(v, dict) else v for k, v in vars(item).items() if k != "id")
        if item.id not in numbers:
            number = self._known.get(what) if len(self.numbers) > 1 else item.id
            if number is None:
                number = item.id if item.id not in declared else max(declared) + 1
            if number >= LOG_REST.items:
                raise LogReadError(f"{self.path} has more than the {LOG_REST.items} channels that one log can have")
            numbers[item.id] = self._known[what] = number
        return item if item.id == numbers[item.id] else replace(item, id=numbers[item.id])

    def gather_blocks(self, most: int) -> Iterator[Block]:
        """The blocks of `blocks`, a few as one: `most` bytes of data, if each has fewer."""
        some: list[Block] = []
        size = 0
        for block in self.blocks():
            if some and size + len(block.data) > most:
                yield together(some)
                some, size = [], 0
            some.append(block)
            size += len(block.data)
        if some:
            yield together(some)

    def topics_of(self, block: Block) -> dict[int, bytes]:
        """The topics of a block's channels, in UTF-8."""
        return {number: self.channels[number].topic.encode() for number in np.unique(block.channel).tolist()}

    def channel(self, topic: str) -> Channel | None:
        """The first channel of a topic that was declared by now, but for one of attachments; None if there is none."""
        return self._by_topic.get(topic)

    def _keep(self, item: Item) -> None:
        match item:
            case Header():
                self.profile = item.profile
            case Schema():
                self._count(Schema, item.id, len(item.data) + _ENTRY)
                self.schemas[item.id] = item
            case Channel():
                self._count(Channel, item.id, _size(item.metadata) + len(item.topic))
                self.channels[item.id] = item
                if not is_attachment(item):
                    self._by_topic.setdefault(item.topic, item)
            case Metadata():
                self._count(Metadata, item.name, _size(item.metadata))
                self.metadata[item.name] = dict(item.metadata)
            case Attachment():
                self._count(Attachment, item.name, len(item.data))
                self.attachments[item.name] = item.data

    def _count(self, kind: type, name: int | str, size: int) -> None:
        self._total += size - self._kept.get((kind, name), 0)
        self._kept[kind, name] = size
        if self._total > LOG_REST.bytes:
            raise LogReadError(
                f"{self.path} declares {self._total} bytes of attachments, metadata, schemas and channels, more than "
                f"the {LOG_REST.bytes} that are kept: it is damaged, or not a log to be read here"
            )


def _size(entries: Mapping[str, str]) -> int:
    return _ENTRY + sum(len(key) + len(value) + _ENTRY for key, value in entries.items())


def missing(salvage: Salvage) -> str:
    """A text that says what is missing in a file; "" if it is complete. The iteration of `salvage` must be over."""
    if salvage.damage:
        return f"{salvage.damage[0]}; reading stopped before it" if not salvage.beyond else describe_loss(salvage)
    if salvage.cut:
        return "the file is cut: the run was killed while it was written, or it is still going on"
    if salvage.stated is not None and salvage.indexed and salvage.stated != salvage.messages:
        return f"{salvage.messages} of {salvage.stated} messages: whole chunks are gone"
    return "" if salvage.indexed else "the index is missing or damaged"


def describe_loss(salvage: Salvage) -> str:
    """A text that says what is lost in a file that was read beyond its damage; "" if no message is lost."""
    places = [str(damage) for damage in salvage.damage]
    if salvage.cut or not salvage.ended:
        places.append("the end: the file is cut")
    elif salvage.indexed and salvage.stated is not None:
        more = salvage.stated - salvage.messages - sum(damage.messages for damage in salvage.damage)
        places += [f"{more} more of {salvage.stated} messages"] if more > 0 else []
    return "; ".join(places)


def digest(path: Path, on_progress: OnProgress = lambda _: None) -> str:
    """SHA-256 over the ordered messages (topic, times, sequence, data), in hexadecimal, as `fleet run` prints it; those
    before the first damaged place. Raises LogReadError as `LogReader` does.
    """
    total, reader = Digest(), LogReader(path, on_progress)
    for block in reader.blocks():
        total.add_block(block, reader.topics_of(block))
    return total.hexdigest()


def log_path(path: Path) -> Path:
    """The path of a log: its file, or the directory of a bag that has several. `path` is the file itself, or the
    directory of a run or of a bag. A link such as `runs/latest` gives the run that it leads to now, since it leads to
    another one after the next run. Raises LogReadError: it is a bag that cannot be read here.
    """
    if not path.is_dir():
        return path if path.suffix == ".mcap" or not path.is_file() else as_mcap(path) or path
    folder = path.parent / path.readlink() if path.is_symlink() else path
    files = _bag(folder)
    if not files and not (folder / "run.mcap").exists() and (made := as_mcap(folder)) is not None:
        return made
    return folder / "run.mcap" if not files else files[0] if len(files) == 1 else folder


def log_files(path: Path) -> list[Path]:
    """The files of a log, the earliest first; `path` as `log_path` gives it. Raises LogReadError as that does."""
    return (_bag(path) if path.is_dir() else []) or [path]


def log_size(path: Path) -> int:
    """The size of a log [bytes]; `path` as `log_path` gives it."""
    return sum(file.stat().st_size for file in log_files(path))


def _bag(folder: Path) -> list[Path]:
    """The MCAP files of a bag of ROS 2, in the order of time; none: the directory is no bag. The bag of a recorder that
    was killed has no metadata.yaml, and perhaps one file.
    """
    if (folder / "run.mcap").exists():
        return []
    try:
        text = read_file(folder / "metadata.yaml", SCENARIO.bytes)
    except FileNotFoundError:
        files = sorted(folder.glob("*.mcap"))
        if len(files) > 1:
            raise LogReadError(
                f"{folder} has {len(files)} MCAP files, and no metadata.yaml that says that they are one bag: name one "
                f"of them, such as {files[0]}"
            ) from None
        return files
    except OSError as error:
        raise LogReadError(f"cannot read {folder / 'metadata.yaml'}: {error.strerror}") from None
    try:
        told = yaml.load(text, _YAML)["rosbag2_bagfile_information"]
        storage, names = told["storage_identifier"], [PurePath(name).name for name in told["relative_file_paths"]]
        if not (names and isinstance(storage, str)):  # the text of lists within lists of YAML's aliases has no end
            raise ValueError
    except (yaml.YAMLError, ValueError, RecursionError, TypeError, KeyError):
        raise LogReadError(f"{folder / 'metadata.yaml'} is not that of a bag of ROS 2, so {folder} is no log") from None
    if storage != "mcap" or not all(name.endswith(".mcap") for name in names):
        kind = storage[:40] if storage != "mcap" else f"mcap, with files such as {names[0]}"
        raise LogReadError(
            f"{folder} is a bag with the storage {kind!r}; expected plain MCAP files, which ros2 bag convert makes"
        )
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        where = folder / "metadata.yaml"
        raise LogReadError(f"{where} names {printable(name)} {count} times: a file is a part of a bag once")
    return [folder / name for name in names]


def open_file(path: Path) -> IO[bytes]:
    """Open a log file for reading, in binary mode; the caller closes it. Raises LogReadError if it cannot be opened, or
    does not begin with the magic bytes of MCAP.
    """
    file = open_any(path)
    try:
        start = file.read(len(MAGIC))
    except OSError as error:
        file.close()
        raise LogReadError(f"cannot read {path}: {error.strerror}") from error
    if start != MAGIC:
        file.close()
        what = "it is empty" if not start else "it does not begin with MCAP's magic bytes"
        if path.suffix in (".yaml", ".yml"):
            raise LogReadError(
                f"{path}: expected a log, got a scenario; fleet run {path} makes a log of it, in a directory below runs"
            )
        raise LogReadError(f"{path} is no MCAP log: {what}; {_WHAT_IT_IS}")
    file.seek(0, io.SEEK_SET)
    return file


def check_readable(paths: Sequence[Path]) -> None:
    """Look at several logs before the first one is read. Raises LogReadError if some cannot be opened or are no MCAP
    files; it says of each one why.
    """
    wrong = []
    for path in paths:
        try:
            for file in log_files(log_path(path)):
                open_file(file).close()
        except LogReadError as error:
            wrong.append(str(error))
    if wrong and len(paths) > 1:
        wrong.append(
            f"{len(paths) - len(wrong)} of {len(paths)} logs can be read: leave out the others, or correct their names"
        )
    if wrong:
        raise LogReadError("\n".join(dict.fromkeys(wrong)))


def open_any(path: Path) -> IO[bytes]:
    """Open any regular file for reading, in binary mode; the caller closes it. Raises LogReadError if it cannot be
    opened, or is no regular file.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # opening a pipe would block
            raise LogReadError(f"cannot read {path}: it is no file")
        return path.open("rb")
    except FileNotFoundError as error:
        raise LogReadError(
            _explain_missing_log(path) or f"cannot read {path}: {error.strerror}; {_WHAT_IT_IS}"
        ) from error
    except OSError as error:
        raise LogReadError(f"cannot read {path}: {error.strerror}") from error


def _explain_missing_log(path: Path) -> str:
    """What to say of a log that is not there because its run was to write none; "" if it was not."""
    scenario = path.with_name("scenario.yaml")
    try:
        lines = read_file(scenario, SCENARIO.bytes).splitlines()
    except (OSError, ValueError):
        return ""
    if b"log: none" not in lines:
        return ""
    return (
        f"{path.parent} has no log, as its scenario says log: none; result.json has its numbers. "
        f"To run it again with a log: fleet run {scenario} --set log={{}}"
    )
