"""A log as numpy arrays, by topic and field: `fleet.open_log`.

The file is read once, in blocks, into one buffer of bytes per topic; a topic is decoded when one of its fields is first
asked for, by the schema that the file itself carries. A message of doubles only has a fixed layout, so all of a topic's
messages are one structured array; what has another layout is decoded by protobuf, message by message. If the buffers
would take more than `MOST_HELD`, they are given up, and a topic is read again when it is asked for.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, overload

import numpy as np

from fleet.logs.fault_intervals import fault_intervals
from fleet.logs.schemas import FROM_TICK, node_names
from fleet.logs.topic import STEP, LogKeyError, Topic
from fleet.logs.topic_names import link_of
from fleet.mcap.digest import Digest
from fleet.mcap.reader import LogReader, LogReadError, OnProgress, digest, log_path, log_size
from fleet.mcap.records import Block
from fleet.mcap.traffic import is_attachment
from fleet.notebook import html_table
from fleet.scenario.sections.timeline import FaultInterval
from netem.parsing import nearest

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from fleet.scenario.scenario import Scenario


class Part(NamedTuple):
    """Which messages of a log are kept."""

    start: float = 0.0  # s
    end: float = inf
    every: int = 1

    def clip_to_time(self, block: Block) -> Block:
        """Those of the time."""
        if self.start <= 0.0 and self.end == inf:
            return block
        t = block.log_ns / 1e9
        return block.take((t >= self.start) & (t <= self.end))

    def thin_out(self, block: Block, seen: int) -> Block:
        """The messages to keep of one topic's messages within the time; `seen` messages came before."""
        return block if self.every == 1 else block.take(np.arange(-seen % self.every, len(block), self.every))


ALL = Part()
MOST_HELD = 320 << 20  # bytes of a log that are held at once
BUCKETS = 4000  # spans of time that a picture can show, at most
_AT_ONCE = 16 << 20  # bytes whose messages are handed out together: a chunk has one or two of each of many topics


class Log:
    """A log that `open_log` has read: a mapping of topic names to `Topic`, and what the log states about its run.

    Example:
        >>> log = open_log("runs/latest")
        >>> log["uuv/1/state"].z.max()  # the greatest depth of vehicle 1 [m]
        >>> [fault.id for fault in log.faults if fault.begin < 20.0]

    Attributes:
        path: the MCAP file.
        run: metadata that determined the result, as text by name: scenario, seed, tick_ns, ticks, vehicles, graph,
            and the versions of what computed it. Empty for a log of another program.
        missing: why the log is not whole, in words; empty if it is whole.
        scenario_text: the merged scenario as YAML; empty if the log holds none.
        most_held: bytes of its messages that are held at once.
    """

    def __init__(self, path: Path, topics: dict[str, Topic], reader: LogReader, most_held: int) -> None:
        """Logs are made by `open_log`."""
        self.path, self.most_held = path, most_held
        self.run = reader.metadata.get("run", {})
        self.missing = reader.missing
        self._topics = topics
        self.scenario_text = reader.attachments.get("scenario.yaml", b"").decode("utf-8", "replace")

    def __getitem__(self, topic: str) -> Topic:
        """The topic of a name.

        Args:
            topic: such as `uuv/1/state`.

        Returns:
            Its messages. They are decoded when a field is first used.

        Raises:
            LogKeyError: the log has no such topic; a `KeyError` as well.
        """
        if not isinstance(topic, str):
            raise LogKeyError(f"topics have names such as 'uuv/1/state', got {topic!r}")
        if topic not in self._topics:
            hint = nearest(topic, self.topics)
            raise LogKeyError(f"{self.path} has no topic {topic!r}; {hint or 'see .topics for those it has'}")
        return self._topics[topic]

    def __contains__(self, topic: object) -> bool:
        return topic in self._topics

    def __iter__(self) -> Iterator[str]:
        return iter(self._topics)

    def __len__(self) -> int:
        return len(self._topics)

    def __repr__(self) -> str:
        word = f", NOT WHOLE: {self.missing}" if self.missing else ""
        return f"<{self.path}: {self.messages} messages in {len(self)} topics, {self.end:g} s{word}>"

    def _repr_html_(self) -> str:
        rows = [(topic.name, topic.schema, len(topic)) for topic in self._topics.values()]
        return html_table(repr(self)[1:-1], ("topic", "message", "samples"), rows)

    @property
    def topics(self) -> list[str]:
        """The names of all topics in the order of the file, also of topics without a message."""
        return list(self._topics)

    @property
    def messages(self) -> int:
        """The number of messages of all topics that were read."""
        return sum(len(topic) for topic in self._topics.values())

    @cached_property
    def end(self) -> float:
        """The simulated time of the last message [s]; 0 for a log without messages."""
        return max((topic.last_ns for topic in self._topics.values() if len(topic)), default=0) / 1e9

    @cached_property
    def begin(self) -> float:
        """When its run began [s]: later than 0 if it went on from another one."""
        try:
            begin = int(self.run.get(FROM_TICK, "0")) * int(self.run["tick_ns"]) / 1e9
        except (KeyError, ValueError, OverflowError):  # another program may have written anything there
            return 0.0
        return begin if 0.0 <= begin < self.end else 0.0

    @cached_property
    def vehicles(self) -> list[int]:
        """The numbers of the vehicles that the log has topics of, ascending from 1."""
        found = {int(match[1]) for topic in self if (match := re.match(r"uuv/(\d+)/", topic))}
        return sorted(found)

    @cached_property
    def links(self) -> list[tuple[int, int]]:
        """The directed links (source, destination) that the log has topics of, ascending."""
        return sorted(link for topic in self if (link := link_of(topic)) is not None)

    @overload
    def to_xarray(self, topic: None = None) -> xr.DataTree: ...
    @overload
    def to_xarray(self, topic: str) -> xr.Dataset: ...

    def to_xarray(self, topic: str | None = None) -> xr.DataTree | xr.Dataset:
        """A topic as a Dataset; None: the topics that are tables, in a tree by their names.

        Columns are those of `fleet export`, with `units` and `long_name`. Where the times of a topic do not rise, `t`
        is no index.

        Example:
            >>> fleet.open_log("runs/latest").to_xarray("uuv/1/state").z.attrs["units"]
            'm'

        Args:
            topic: name of the topic.

        Returns:
            Variables of (t,) each, a vector as one variable per component.

        Raises:
            FleetError: xarray is not installed (extra `tables`), or the topic is no table.
            LogReadError: there is no such topic, or more memory is needed than allowed; `open_log` can choose topics.
        """
        from fleet.logs.dataset import table, tree

        if topic is not None:
            return table(self[topic], self.run)
        return tree(self.path, self._topics.values(), self.run, self.most_held)

    def to_pandas(self, topic: str) -> pd.DataFrame:
        """A topic as a table.

        Args:
            topic: name of the topic.

        Returns:
            A row per message, a column per number. `attrs["units"]` and `attrs["meanings"]` say what is in each column.

        Raises:
            FleetError: pandas is not installed (extra `tables`), or the topic is no table.
            LogReadError: the log has no such topic, or it is too large.
        """
        from fleet.logs.dataset import frame

        return frame(self[topic])

    @cached_property
    def scenario(self) -> Scenario:
        """The merged scenario that was run, without the faults that were injected into the run.

        No module that it names is imported.

        Raises:
            LogReadError: the log holds no scenario.
            ScenarioError: another version wrote the scenario, and this one does not accept it.
        """
        from fleet.scenario.loading import parse_scenario

        if not self.scenario_text:
            raise LogReadError(f"{self.path} holds no scenario: it was not written by fleet run, or cut at its start")
        return parse_scenario(self.scenario_text, str(self.path))

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the ordered messages of the file, in hexadecimal, as `fleet run` prints it.

        It covers all topics, also unopened ones. For a damaged file it covers the part before the damage.

        Raises:
            LogReadError: the file is not there any more.
        """
        return digest(self.path)

    @property
    def faults(self) -> list[FaultInterval]:
        """The faults in the order of their beginnings; empty for a log without the topic `faults`.

        Raises:
            LogReadError: the log holds more events of faults than are read.
        """
        return [interval for interval in self._intervals if interval.is_fault]

    @property
    def events(self) -> list[FaultInterval]:
        """When vehicles were tumbled or diverged, in the order of the beginnings.

        Raises:
            LogReadError: the log holds more events of faults than are read.
        """
        return [interval for interval in self._intervals if not interval.is_fault]

    @cached_property
    def _intervals(self) -> list[FaultInterval]:
        return fault_intervals(self["faults"], self.end, node_names(self.run)) if "faults" in self else []


def open_log(
    path: str | Path,
    topics: Iterable[str] | None = None,
    progress: Callable[[float], None] = lambda _: None,
    *,
    start: float = 0.0,
    end: float = inf,
    every: int = 1,
    share: OnProgress = lambda _: None,
) -> Log:
    """Read a log, whole or cut, as numpy arrays.

    The file is read once; the messages of a topic are decoded when one of its fields is first used. A log that is too
    large for memory (320 MB of messages) is read again for each topic that is used. A topic that is too large by
    itself raises `LogReadError` then, with the arguments that make it smaller.

    Example:
        >>> import fleet
        >>> log = fleet.open_log("runs/latest", ["uuv/*/state", "faults"], start=10.0, end=30.0)
        >>> log["uuv/2/state"].t.shape == log["uuv/2/state"].x.shape
        True

    Args:
        path: an MCAP file, a run directory, or the directory of a bag of ROS 2.
        topics: keep only topics that match one of these patterns of `fnmatch`, such as `uuv/*/state`; None: all.
        progress: called now and then with the simulated time reached [s].
        start: keep only messages from this simulated time on [s].
        end: keep only messages up to this simulated time [s], inclusive.
        every: keep one in this number of messages of each topic, beginning with the first.
        share: called now and then with the share of the file that was read, 0 to 1.

    Returns:
        the topics of the log, also of a log that is cut or damaged: then every message before the first damaged
        place, and `Log.missing` says what is missing.

    Raises:
        LogReadError: the file cannot be opened or is no MCAP file, or `start`, `end` or `every` exclude one another.
    """
    if every < 1:
        raise LogReadError(f"every={every}: it is the number of messages of which one is kept, 1 or more")
    if not start <= end:
        raise LogReadError(f"start={start:g} s, end={end:g} s: the start comes first")
    return Opening(Path(path), topics, share, progress=progress, part=Part(start, end, every)).read()


@dataclass
class Opening:
    """How a log is read: once, and topics again if they could not all be held."""

    path: Path  # as `log_path` takes it
    topics: Iterable[str] | None = None  # patterns of topics to keep; None: all
    share: OnProgress = lambda _: None  # called with the share of the file that was read
    exclude: Sequence[str] = ()  # patterns of topics not to keep
    progress: Callable[[float], None] = lambda _: None  # called with the simulated time reached [s]
    part: Part = ALL
    # For pictures: pattern of topics -> the fields that are kept of them if the log is too large. Each signal then
    # keeps its visible part: the first and last sample and the extremes of short spans of time.
    drawn: Mapping[str, frozenset[str]] | None = None
    hold_all: bool = True  # False: messages are counted; a topic is read when one of its fields is used
    most_held: int = MOST_HELD  # bytes

    def __post_init__(self) -> None:
        self.path = log_path(self.path)
        self.topics = [self.topics] if isinstance(self.topics, str) else self.topics and list(self.topics)
        self._topics: dict[str, Topic | None] = {}
        self._held: list[Topic] = []  # topics that were fetched, the oldest first
        self._seen: Counter[str] = Counter()

    def read(self) -> Log:
        """The log, with what could be held. Raises LogReadError if there is none."""
        reader = LogReader(self.path, self.share)
        total = None if self.drawn is None else Digest()  # a picture says of which log it is
        plain = self.drawn is None and self.part == ALL
        for block in reader.gather_blocks(_AT_ONCE):
            if total is not None:
                total.add_block(block, reader.topics_of(block))
            if plain and self.topics is None and log_size(self.path) > self.most_held:
                self.hold_all = False  # what is held now would be given up later
            take = self._count if plain and not self.hold_all else self._take
            take(reader, block)
            self.progress(int(block.log_ns[-1]) / 1e9)
            if (self.hold_all or total is not None) and self._cost() > self.most_held:
                self._relieve()
        # In the order of the channels, with those that hold nothing.
        ordered = {channel.topic: None for channel in reader.channels.values() if not is_attachment(channel)}
        kept = {name: self._topic(reader, name) for name in ordered}
        log = Log(self.path, {name: topic for name, topic in kept.items() if topic is not None}, reader, self.most_held)
        if total is not None:
            log.digest = total.hexdigest()
        return log

    def _take(self, reader: LogReader, block: Block) -> None:
        for name, some in self._of(reader, block):
            topic = self._topic(reader, name)
            if topic is None:
                continue
            topic.count(len(some), int((some.end - some.begin).sum()), int(some.log_ns.max()))
            if self.hold_all or (self.drawn is not None and not topic.too_many):
                topic.add(some)

    def _count(self, reader: LogReader, block: Block) -> None:
        """Count all messages of a block without a look at each topic's."""
        counts = np.bincount(block.channel)
        sizes = np.bincount(block.channel, block.end - block.begin)
        last_ns = np.zeros(len(counts), np.uint64)
        np.maximum.at(last_ns, block.channel, block.log_ns)
        for number in np.flatnonzero(counts).tolist():
            if is_attachment(reader.channels[number]):
                continue
            topic = self._topic(reader, reader.channels[number].topic)
            if topic is not None:
                topic.count(int(counts[number]), int(sizes[number]), int(last_ns[number]))

    def _topic(self, reader: LogReader, name: str) -> Topic | None:
        if name not in self._topics:
            self._topics[name] = self._made(reader, name)
        return self._topics[name]

    def _made(self, reader: LogReader, name: str) -> Topic | None:
        if self.topics is not None and not any(fnmatchcase(name, pattern) for pattern in self.topics):
            return None
        if any(fnmatchcase(name, pattern) for pattern in self.exclude):
            return None
        channel = reader.channel(name)
        assert channel is not None  # the name is from the list of channels
        return Topic(name, channel, reader.schemas.get(channel.schema_id), self._fetch, self.most_held)

    def _of(self, reader: LogReader, block: Block) -> Iterator[tuple[str, Block]]:
        for number, some in self.part.clip_to_time(block).by_channel():
            name = reader.channels[number].topic
            if is_attachment(reader.channels[number]):
                continue
            kept = self.part.thin_out(some, self._seen[name])
            self._seen[name] += len(some)
            if len(kept):
                yield name, kept

    def _cost(self) -> int:
        return sum(topic.cost for topic in self._topics.values() if topic is not None)

    def _relieve(self) -> None:
        """Too much is held: forget all of it, or what a picture does not show."""
        self.hold_all = False
        topics = [topic for topic in self._topics.values() if topic is not None and not topic.too_many]
        if self.drawn is None:
            for topic in topics:
                topic.drop()
            return
        for topic in topics:
            for pattern, fields in self.drawn.items():
                if fnmatchcase(topic.name, pattern):
                    topic.fields_kept = fields
            try:
                topic.compact()
            except LogReadError:
                topic.refuse()
                continue
            if topic.doubles and len(topic):
                topic.thin(max(50, min(BUCKETS, self.most_held // (5000 * len(topics)))))
        for topic in sorted(topics, key=lambda topic: -topic.cost):
            if self._cost() <= self.most_held // 4 * 3:
                break
            topic.refuse()

    def _fetch(self, topic: Topic) -> None:
        """Read one topic again; raises LogReadError if it is too large by itself."""
        while self._held and sum(topic.cost for topic in self._held) > self.most_held // 2:
            self._held.pop(0).drop()
        reader = LogReader(self.path, self.share)
        self._seen.clear()
        for block in reader.gather_blocks(_AT_ONCE):
            its = [number for number, channel in reader.channels.items() if channel.topic == topic.name]
            for _, some in self._of(reader, block.take(np.isin(block.channel, np.array(its, np.uint16)))):
                topic.add(some)
                topic.compact(STEP * 2)
                if topic.cost > self.most_held:
                    topic.drop()
                    raise topic.too_large()
        self._held.append(topic)
