"""A live run for Foxglove's viewers: what they subscribe to is fetched from the run's publisher, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fleet.replay.attachment import unpack
from fleet.replay.capture import PublisherGone
from fleet.replay.topics import ask_topics
from fleet.terminal.fitting import Piece
from fleet.terminal.status_line import StatusLine
from fleet.view.foxglove_server import FELL_BEHIND, Channel, FoxgloveServer, Subscription
from fleet.view.foxglove_services import services
from fleet.view.source import LiveSource, ViewerError
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus

POLL_S = 0.02
CLOCK = "transforms"  # the topic by which we know the time, and what was lost: it comes at a fixed period


class LiveBridge:
    """From the publisher of a live run to a server for viewers."""

    def __init__(self, source: LiveSource, bus: OpenBus, host: str, port: int | None, *, control: bool) -> None:
        """Ask for the topics, and listen.

        Args:
            bus: joined to the run's publisher.
            control: whether viewers may inject, heal and hold the clock.

        Raises:
            TopicsError: the run does not say what it publishes.
            ViewerError: there is no port, or only the observer's credentials are at hand, and viewers are to control.
        """
        if control and source.run is None:
            raise ViewerError(
                f"only what an observer needs is at hand ({source.directory}): the run can be watched, with --read-only"
            )
        self._bus, self._keys = bus, Keys(source.observed.run)
        self._topics = ask_topics(bus, self._keys)
        self._numbers = {topic: n for n, topic in enumerate(sorted(self._topics))}
        self.server = FoxgloveServer(
            source.directory.name,
            host,
            port,
            {
                n: Channel(
                    topic, "protobuf", self._topics[topic].schema, "protobuf", self._topics[topic].descriptor_set
                )
                for topic, n in self._numbers.items()
            },
            services=services(source.run) if control and source.run is not None else (),
        )
        self._names = {n: topic for topic, n in self._numbers.items()}
        self._ends: dict[int, Callable[[], None]] = {}
        self._latest_ns = 0
        self._ticks = Gaps()

    def run(self, line: StatusLine) -> None:
        """Go on until the run is over."""
        over = PublisherGone(lambda: self._bus.connected)
        if CLOCK in self._numbers:
            self._fetch(self._numbers[CLOCK])
        while not over():
            for event in self.server.events(POLL_S):
                if isinstance(event, Subscription):
                    self._follow(event.channel)
            self.server.time(self._latest_ns)
            if self.server.fell_behind():
                line.print(FELL_BEHIND)
            if line.due():
                line.show(self._describe())
        self.server.say("the run is over")

    def _follow(self, number: int) -> None:
        """Fetch a channel, or no longer, as viewers want."""
        if number in self.server.wanted:
            if number not in self._ends:
                self._fetch(number)
        elif number in self._ends and self._names[number] != CLOCK:
            self._ends.pop(number)()

    def _fetch(self, number: int) -> None:
        topic = self._names[number]
        self._ends[number] = self._bus.subscribe(self._keys.log(topic), self._receiver(number, topic == CLOCK))

    def _receiver(self, number: int, clock: bool) -> Callable[[Any], None]:
        """What takes the samples of a channel, on a thread of zenoh's."""

        def receive(sample: Any) -> None:
            stamp = unpack(sample.attachment.to_bytes())
            self._latest_ns = max(self._latest_ns, stamp.log_ns)
            if clock:
                self._ticks.add(stamp.sequence)
            self.server.put(number, sample.payload.to_bytes(), stamp.log_ns)

        return receive

    def _describe(self) -> list[Piece]:
        viewers = self.server.viewers
        lost = f"{self._ticks.lost} of {self._ticks.lost + self._ticks.came} {CLOCK} lost"
        return [
            Piece(0, [f"t = {self._latest_ns / 1e9:.2f} s"]),
            Piece(1, [f"{viewers} viewer{'' if viewers == 1 else 's'}"]),
            Piece(2, [f"{len(self.server.wanted)} of {len(self._topics)} topics", ""]),
            Piece(3, [f"{self.server.sent} messages", ""]),
            Piece(2, [lost if self._ticks.lost else "", ""]),
        ]


class Gaps:
    """What is missing in numbers that rise by a fixed step, which is the least that was seen."""

    def __init__(self) -> None:
        self.came = 0
        self._first = self._last = self._step = 0

    def add(self, number: int) -> None:
        """The next number."""
        if not self.came:
            self._first = number
        else:
            rise = number - self._last
            self._step = min(self._step or rise, rise)
        self._last = number
        self.came += 1

    @property
    def lost(self) -> int:
        """How many did not come, between the first and the last."""
        return (self._last - self._first) // self._step + 1 - self.came if self._step > 0 else 0
