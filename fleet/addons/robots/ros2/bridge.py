"""A live run, or a log that is played, to ROS 2: what nodes subscribe to is made and published, and the time always."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

from mcap.records import Schema

from fleet.addons.page.source import LiveSource
from fleet.addons.robots.ros2.mapping import OF_BRIDGE, SOURCES, is_source
from fleet.addons.robots.ros2.node import RosNode
from fleet.addons.robots.ros2.translation import RosMessage, Translation
from fleet.addons.robots.ros2.types import OWN
from fleet.errors import FleetError
from fleet.execution.connection import LiveRun, OpenConnection, RemoteError, ask, find
from fleet.mcap.seekable_log import SeekableLog, Track
from fleet.replay.capture import PublisherGone
from fleet.replay.live_journal import LiveJournal, left_out
from fleet.replay.playback import play_out
from fleet.replay.player import Player
from fleet.replay.topics import ask_topics
from fleet.scenario.text.fault_words import read_fault
from fleet.terminal.keyboard import Keyboard
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine

POLL_S = 0.05
CLOCK_NS = 5_000_000  # between two messages of /clock, at least
ASK_S = 2.0  # between two looks at the checks
COME_S = 1.0  # after the run, for what is still on its way


class RosBridge:
    """Publishes what a journal says; `take` its messages in their order."""

    def __init__(self, node: RosNode, translation: Translation) -> None:
        """Declare the topics. Raises FleetError: a type is not known."""
        self.node, self._translation = node, translation
        self._publishers = {name: node.publisher(name, one.type, one.qos) for name, one in translation.topics()}
        (clock,) = OF_BRIDGE
        self._clock = node.publisher(clock.name, clock.type, clock.qos)
        translation.wanted = lambda name: self._publishers[name].matched
        self.at_ns = self._told_ns = -CLOCK_NS
        self.published = 0

    def take(self, topic: str, log_ns: int, data: bytes) -> None:
        if not 0 <= log_ns - self._told_ns < CLOCK_NS:  # a log that is played again goes back
            self._told_ns = log_ns
            self._clock.publish(self._translation.maker.clock(log_ns))
        self.at_ns = log_ns
        for message in self._translation(topic, log_ns, data):
            self._publish(message)

    def checks(self, rows: list[dict[str, Any]]) -> None:
        if self._translation.diagnostics.checks(rows):
            self._publish(self._translation.diagnostics_message(max(0, self.at_ns)))

    def _publish(self, message: RosMessage) -> None:
        publisher = self._publishers[message.name]
        if publisher.matched:
            publisher.publish(message.message)
            self.published += 1

    def tell(self, line: StatusLine) -> None:
        """Say what is wrong with what others do."""
        while self.node.problems:
            line.print(f"warning: {self.node.problems.popleft()}")

    def describe(self) -> list[Piece]:
        wanted = sum(publisher.matched for publisher in self._publishers.values())
        return [
            Piece(0, [f"t = {max(0, self.at_ns) / 1e9:.2f} s"]),
            Piece(1, [f"{wanted} of {len(self._publishers)} topics wanted"]),
            Piece(2, [f"{self.published} messages", ""]),
        ]


def schemas_of(journal: LiveJournal) -> dict[str, Schema | None]:
    """The schemas of the topics of a live run. Raises FleetError: it does not say what it publishes."""
    topics = ask_topics(journal.bus, journal.keys)
    return {
        topic: Schema(number, found.descriptor_set, "protobuf", found.schema)
        for number, (topic, found) in enumerate(topics.items(), start=1)
    }


def show_run(bridge: RosBridge, journal: LiveJournal, source: LiveSource, line: StatusLine) -> None:
    for topic in SOURCES:
        journal.subscribe(topic)
    over = PublisherGone(lambda: journal.bus.connected)
    checks = _Checks(source)
    ended: float | None = None
    try:
        while ended is None or (journal.missing.to_come and time.monotonic() - ended < COME_S):
            journal.wait(POLL_S)
            for message in journal.take():
                bridge.take(*message)
            bridge.checks(checks.look())
            bridge.tell(line)
            line.update(bridge.describe)
            if ended is None and over():
                ended = time.monotonic()
    finally:
        checks.close()
    if count := journal.missing.count:
        line.print(left_out(count))


def play_log(
    bridge: RosBridge, log: SeekableLog, keyboard: Keyboard, line: StatusLine, *, rate: float, loop: bool
) -> None:
    track = Track(log, [number for number, channel in log.channels.items() if is_source(channel.topic)])
    now = time.monotonic_ns()
    player = Player(track, 0, log.end_ns, rate=rate, loop=loop, now=now, before=track.before)

    def publish(some: range) -> None:
        for _, entry in track.entries(some):
            bridge.take(entry.channel.topic, entry.log_ns, entry.data)
        bridge.tell(line)

    play_out(player, keyboard, line, publish, bridge.describe)


def offer_control(node: RosNode, run: LiveRun) -> None:
    """Offer the services that disturb a run. Raises FleetError: a type is not known."""

    def inject(request: Any) -> str:
        answer = ask(run, "inject", fault=read_fault(request.what))
        return str(answer.get("id", ""))

    def heal(request: Any) -> str:
        return ", ".join(map(str, ask(run, "heal", id=request.id or None).get("healed", ())))

    for name, do in (("Inject", inject), ("Heal", heal)):
        kind = f"{OWN}/srv/{name}"

        def answer(request: Any, kind: str = kind, do: Any = do) -> Any:
            try:
                return node.types.new(f"{kind}_Response", success=True, message=do(request))
            except FleetError as error:
                return node.types.new(f"{kind}_Response", success=False, message=str(error))

        node.serve(f"/fleet/{name.lower()}", kind, answer)


class _Checks:
    """Asks the console of a run for its checks now and then, as soon as it answers."""

    def __init__(self, source: LiveSource) -> None:
        self._source, self._run = source, source.run
        self._connection: OpenConnection | None = None
        self._rows: list[dict[str, Any]] = []
        self._next = 0.0

    def look(self) -> list[dict[str, Any]]:
        """The checks as they stood when they were asked for last; none before the first answer."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + ASK_S
            with suppress(RemoteError):
                self._run = self._run or find(str(self._source.directory))
                self._connection = self._connection or OpenConnection(self._run)
                self._rows = self._connection.ask("checks")["checks"]
        return self._rows

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
