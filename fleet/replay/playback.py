"""`fleet replay`: a log on zenoh again, topic for topic, at its own times. The shell around `Player`."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence

from mcap.records import Channel

from fleet.errors import FleetError
from fleet.logs.decoder import UNITS
from fleet.mcap.seekable_log import Entry, SeekableLog, Track
from fleet.mcap.traffic import ATTACHMENT, DELETE, ENCODING, KIND
from fleet.replay.capture import zenoh_encoding
from fleet.replay.player import RATE_STEP, SEEK_NS, MeasuredRate, PlaybackOptions, Player
from fleet.replay.topics import Stamp, hand_out, pack
from fleet.terminal.keyboard import Key, Keyboard
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine
from netem.parsing import nearest
from netem.wire.key_expression import is_key, matching
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus, OpenPublication

MOST = 256  # messages between two looks at the keyboard
NAP_S = 0.05  # the longest wait without a look at the clock
RUN = "replay"  # in keys


class Replay:
    """One log, selected and bound to keys. Nothing is published before `play`."""

    def __init__(self, log: SeekableLog, options: PlaybackOptions) -> None:
        """Choose what to play. Raises FleetError: a topic names nothing, or nothing is left to play."""
        self._log, self._wishes = log, options
        self.keys = Keys(RUN)
        self.ours = "uuv-fleet" in log.metadata.get("run", {})  # a journal, with sim time and a prefix of its own
        kinds = {n: channel.metadata.get(KIND, "") for n, channel in log.channels.items()}
        played = {n: c for n, c in log.channels.items() if kinds[n] != ATTACHMENT}
        names = chosen((c.topic for c in played.values()), options.topics, options.exclude)
        self.no_keys = sorted(name for name in names if not is_key(name.strip("/")))
        self.key_of = {
            n: self.keys.log(c.topic.strip("/")) if self.ours else c.topic.strip("/")
            for n, c in played.items()
            if c.topic in names.difference(self.no_keys)
        }
        self._latched = [n for n in self.key_of if _is_latched(played[n])]
        self._after = 0  # what comes next if the player does not jump
        self._deletes = {n for n in self.key_of if kinds[n] == DELETE}
        self._attached = ATTACHMENT in kinds.values()
        self._track = track = Track(log, self.key_of)
        # Simulated time begins at 0, whatever is logged first; any other time with the first message.
        self.zero_ns = 0 if self.ours else log.due(0)
        begin = self.zero_ns + options.start_ns
        end = track[len(track) - 1] if len(track) else begin
        if options.end_ns is not None:
            end = min(end, self.zero_ns + options.end_ns)
        first, stop = track.before(begin), track.before(end + 1)
        if first >= stop:
            last = (log.end_ns - self.zero_ns) / 1e9
            why = f"; {self.left_out}" if self.no_keys else ""
            raise FleetError(
                f"nothing to play: the log ends at {last:g} s, and no chosen message is in what was asked for{why}"
            )
        self._first, self.messages = first, stop - first
        self._begin, self._end = begin, end
        self._publications: dict[int, OpenPublication] = {}
        self.published = 0
        self.player = self._player(0)

    def _player(self, now: int) -> Player:
        w = self._wishes
        return Player(
            self._track, self._begin, self._end, rate=w.speed, loop=w.loop, paused=w.step, now=now,
            before=self._track.before,
        )  # fmt: skip

    @property
    def left_out(self) -> str:
        """Which topics are no keys, in words; empty: all of them are."""
        more = f" and {len(self.no_keys) - 8} more" if len(self.no_keys) > 8 else ""
        return f"no keys of zenoh: {', '.join(map(repr, self.no_keys[:8]))}{more}" if self.no_keys else ""

    def open(self, bus: OpenBus) -> None:
        """Declare the keys."""
        log = self._log
        for n, key in self.key_of.items():
            channel = log.channels[n]
            schema = log.schemas.get(channel.schema_id)
            encoding = channel.metadata.get(ENCODING) or zenoh_encoding(
                channel.message_encoding, schema.name if schema else ""
            )
            self._publications[n] = bus.publication(key, encoding, drop=False)
        if self.ours:
            topics = {
                key.removeprefix(self.keys.log("")): log.schemas[log.channels[n].schema_id].name
                for n, key in self.key_of.items()
                if log.channels[n].schema_id in log.schemas
            }
            units = {
                log.schemas[channel.schema_id].name: channel.metadata[UNITS]
                for channel in log.channels.values()
                if channel.schema_id in log.schemas and UNITS in channel.metadata
            }
            hand_out(bus, self.keys, topics, {schema.name: schema.data for schema in log.schemas.values()}, units)

    def unmatched_keys(self) -> list[str]:
        return [self.key_of[n] for n, publication in self._publications.items() if not publication.matched]

    def play(self, keyboard: Keyboard, line: StatusLine) -> None:
        self._wait(line)
        next(self._track.entries(range(self._first, self._first + 1)))  # decompressed before the clock starts
        self.player = player = self._player(time.monotonic_ns())
        pace = MeasuredRate()
        if not player.paused:
            now = time.monotonic_ns()
            pace.update(now, player.position(now))  # without a terminal the first line comes after some seconds
        play_out(player, keyboard, line, self._publish, lambda: self._describe(time.monotonic_ns(), pace), pace.restart)

    def _wait(self, line: StatusLine) -> None:
        while self._wishes.wait_for_subscribers and (missing := self.unmatched_keys()):
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            if line.due():
                line.show(f"waiting for a subscriber on {missing[0]}{more}")
            time.sleep(0.02)

    def _publish(self, some: range) -> None:
        if some and some.start != self._after:
            for number, entry in self._log.last(self._latched, self._track[some.start]):
                self._put(number, entry)
        for number, entry in self._track.entries(some):
            self._put(number, entry)
        self._after = some.stop if some else self._after

    def _put(self, number: int, entry: Entry) -> None:
        publication = self._publications[entry.channel.id]
        if self.ours:
            attachment: bytes | None = pack(Stamp(entry.log_ns, entry.publish_ns, entry.sequence, number))
        else:
            attachment = self._attachment(number, entry.sequence)
        if entry.channel.id in self._deletes:
            publication.delete(attachment)
        else:
            publication.put(entry.data, attachment)
        self.published += 1

    def _attachment(self, number: int, sequence: int) -> bytes | None:
        if not number or not self._attached:
            return None
        entry = self._log[number - 1]
        attached = entry.channel.metadata.get(KIND) == ATTACHMENT and entry.sequence == sequence
        return entry.data if attached else None

    def _describe(self, now: int, pace: MeasuredRate) -> list[Piece]:
        player = self.player
        at = player.position(now)
        reached = pace.update(now, at) if not player.paused else 0.0
        state = "paused" if player.paused else f"{reached:.2f} x real time"
        wanted = f" of {player.rate:.3g}" if player.rate and not player.paused else ""
        late = f"{player.missed} late"
        return [
            Piece(0, [f"t = {(at - self.zero_ns) / 1e9:.2f} / {(self._end - self.zero_ns) / 1e9:.2f} s"]),
            Piece(1, [f"{state}{wanted}", state]),
            Piece(2, [f"{self.published} messages, {late}", late, ""]),
            Piece(3, [f"lap {player.laps + 1}", ""] if self._wishes.loop else [""]),
        ]

    def summary(self, wall_s: float) -> str:
        return (
            f"played {self.published} messages in {wall_s:.2f} s "
            f"({self.published / max(wall_s, 1e-9):.0f} messages/s), {self.player.missed} late"
        )


def play_out(
    player: Player,
    keyboard: Keyboard,
    line: StatusLine,
    publish: Callable[[range], None],
    describe: Callable[[], list[Piece]],
    jumped: Callable[[], None] = lambda: None,
) -> None:
    """Hand out messages when they are due, and obey the keyboard, until all are played. `publish`: gets the indexes of
    messages. `jumped`: called when the time does not just go on."""
    while not player.over:
        if away := keyboard.suspended_ns():
            player.stood_still(away)
            jumped()
        publish(player.due(time.monotonic_ns(), MOST))
        if line.due():
            line.show(describe())
        wait_ns = 0 if player.over else player.wait_ns(time.monotonic_ns())
        for key in keyboard.read(NAP_S if wait_ns is None else min(NAP_S, wait_ns / 1e9)):
            publish(obey(player, key, time.monotonic_ns()))
            jumped()
            line.show(describe())


def obey(player: Player, key: Key, now: int) -> range:
    """Carry out the command of a key press. Returns indexes of the messages to publish. Only the key for one step has
    any."""
    match key:
        case Key.PAUSE:
            player.toggle(now)
        case Key.STEP:
            return player.step(now)
        case Key.FASTER:
            player.set_rate(now, player.rate * RATE_STEP)
        case Key.SLOWER:
            player.set_rate(now, player.rate / RATE_STEP)
        case Key.FORWARD:
            player.seek(now, player.position(now) + SEEK_NS)
        case Key.BACK:
            player.seek(now, player.position(now) - SEEK_NS)
    return range(0)


def chosen(topics: Iterable[str], patterns: Sequence[str], exclude: Sequence[str] = ()) -> set[str]:
    """The topics that any of the patterns names, all of them without one, but not those that `exclude` names. Patterns
    are key expressions of zenoh; slashes around them and around topics do not count. Raises FleetError: a pattern names
    none."""
    known = sorted(set(topics))

    def named(some: Sequence[str]) -> set[str]:
        names: set[str] = set()
        for text in some:
            included = matching(text.strip("/"))
            found = {topic for topic in known if included(topic.strip("/"))}
            if not found:
                hint = nearest(text, known) or f"there are {', '.join(known[:8])}{', ...' if len(known) > 8 else ''}"
                raise FleetError(f'no topic of the log is called "{text}": {hint}')
            names |= found
        return names

    return (named(patterns) if patterns else set(known)) - named(exclude)


_TRANSIENT_LOCAL = re.compile(r"durability: *(transient_local|1)\b")  # in a bag: in words, or its number in rmw


def _is_latched(channel: Channel) -> bool:
    """Whether a late subscriber expects the last message: static transforms, and what publishers of ROS 2 keep."""
    offered = channel.metadata.get("offered_qos_profiles", "")
    return channel.topic.strip("/").endswith("tf_static") or _TRANSIENT_LOCAL.search(offered) is not None
