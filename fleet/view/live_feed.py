"""A live run as a page shows it: its journal from the publisher, its clock and faults from its console.

The publisher is a process of its own, so nothing here can hold the run up. What zenoh's thread brings waits in a queue
until the next picture; what the queue has no room for is left out and counted.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any

from fleet.errors import FleetError
from fleet.execution.connection import LiveRun, OpenConnection, RemoteError, find, is_live
from fleet.execution.directory import SCENARIO, in_use
from fleet.logs.topic_names import BELIEFS, link_of
from fleet.replay.attachment import unpack
from fleet.replay.missing import Missing, left_out
from fleet.replay.player import MeasuredRate
from fleet.replay.topics import ask_scenario, ask_topics
from fleet.result.file import RESULT
from fleet.scenario.loading import parse_scenario
from fleet.scenario.sections.checked_signals import checked_signals
from fleet.view.chart_signals import published_signals
from fleet.view.feed import FAULTS, TRANSFORMS, checks_asked, checks_so_far, take
from fleet.view.source import LiveSource
from fleet.view.view_state import NOT_PLACED, SAMPLE_S, Row, ViewState
from netem.errors import BusError
from netem.wire.access import Credentials
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus, place_of

MOST_WAITING = 50_000  # messages between two pictures


class LiveFeed:
    """Follows one live run."""

    live = True

    def __init__(self, source: LiveSource) -> None:
        """Connect, and subscribe unless the run is awaited: then `listen` does.

        Raises:
            FleetError: the publisher cannot be reached, or does not say what it publishes.
            ScenarioError: that scenario is none for this version.
        """
        self.source = source
        self.name = source.directory.name
        self.log = source.directory / "run.mcap"
        self.missing = Missing()
        self._waiting: deque[Any] = deque(maxlen=MOST_WAITING)
        self._newest: dict[str, Any] = {}  # beliefs since the last picture, by key: it shows one of each vehicle
        self._status: Row = {}
        self._over = ""  # why there is nothing more to come
        self._published = True
        self._rate = MeasuredRate()
        self._ends: dict[str, Callable[[], None]] = {}  # of the subscriptions to topics of signals
        self._connection: OpenConnection | None = None
        observed = source.observed
        self._keys = Keys(observed.run)
        try:
            self._bus = OpenBus.connect(observed.endpoint, Credentials(observed.user, observed.password))
        except BusError as error:
            raise FleetError(f"the journal of {self.name} cannot be read: {error}", status=3) from None
        try:
            text = ask_scenario(self._bus, self._keys)
            self.scenario = parse_scenario(text, str(source.directory / SCENARIO))
            self.signals = published_signals(ask_topics(self._bus, self._keys))
        except BaseException:
            self._bus.close()
            raise
        self.picture = ViewState(self.scenario)
        self.checks = checks_asked(self.scenario)  # as they stand
        checked = map(str, checked_signals(self.scenario.spec.checks))
        self.charted = [name for name in checked if self.signals.of_all(name)]
        self._run = source.run
        self._bus.subscribe(self._keys.log_end, lambda sample: self.missing.end(sample.payload.to_bytes()))
        self._listening = False
        if not source.awaited:
            self.listen()

    def listen(self) -> None:
        """Subscribe to what is drawn, once; a run that waits for a subscriber begins then."""
        if not self._listening:
            self._listening = True
            for topic in (TRANSFORMS, FAULTS, "link/*"):
                self._subscribe(topic)
            if self.picture.scene.navigating:
                self._bus.subscribe(self._keys.log(BELIEFS), self._believes)

    def _subscribe(self, topic: str) -> Callable[[], None]:
        return self._bus.subscribe(self._keys.log(topic), self._receive)

    def _receive(self, sample: Any) -> None:
        """On a thread of zenoh."""
        self._waiting.append(sample)  # when it is full, the oldest one goes

    def _believes(self, sample: Any) -> None:
        """On a thread of zenoh."""
        self._newest[str(sample.key_expr)] = sample

    @property
    def run(self) -> LiveRun | None:
        """The run, if it may be disturbed."""
        return self._run

    @property
    def may_act(self) -> bool:
        """Whether the run may be disturbed, now or as soon as its console answers."""
        return self._run is not None or self.source.awaited

    def advance(self) -> bool:
        """Take what has come; whether there is something new to show."""
        waiting, prefix = self._waiting, len(self._keys.log(""))
        beliefs = [self._newest.pop(key) for key in list(self._newest)]
        come = [waiting.popleft() for _ in range(len(waiting))]
        placed: tuple[float, bytes] | None = None
        shown_s = self.picture.at_s
        for sample in come:
            topic = str(sample.key_expr)[prefix:]
            if (at_s := _logged_s(sample)) is None:
                continue
            self.missing.came(topic, place_of(sample))
            data = sample.payload.to_bytes()
            if topic == TRANSFORMS:
                # As fast as it goes, a run makes more of them than anybody can see.
                if placed is not None and placed[0] - shown_s >= SAMPLE_S:
                    take(self.picture, topic, *placed)
                    shown_s = placed[0]
                placed = at_s, data
            else:
                take(self.picture, topic, at_s, data)
                for name, value in self.signals.values(topic, data):
                    self.picture.signal(name, at_s, value)
        if placed is not None:
            take(self.picture, TRANSFORMS, *placed)
        for sample in beliefs:
            if (at_s := _logged_s(sample)) is not None:
                take(self.picture, str(sample.key_expr)[prefix:], at_s, sample.payload.to_bytes())
        self._rate.update(time.monotonic_ns(), int(self.picture.at_s * 1e9))
        return bool(come or beliefs)

    def look(self) -> None:
        """Ask the console how it is doing. Waits for the answer: on a thread of its own."""
        if self._over:
            return
        self._published = self._bus.connected
        if self._run is None and self.source.awaited and in_use(self.source.directory):
            with suppress(RemoteError):
                self._run = find(str(self.source.directory))
            if self._run is None:
                return
        if self._run is None:
            if not self._published:
                self._over = "the publisher is gone"
            return
        try:
            self._status = self.ask("status")
            known = self.ask("faults")
            events = known["events"]
            lasting = [
                {"id": row["id"], "what": row["what"], "from_s": row["last_s"], "to_s": self._status["end_s"],
                 "until_healed": False}
                for row in events if row["lasts"]
            ]  # fmt: skip
            self.picture.faults([*known["faults"], *lasting])
            self.picture.happened(events)
            self.checks = checks_so_far(self.ask("checks")["checks"])
        except RemoteError as error:
            if is_live(self._run):
                self._status = self._status | {"waiting": str(error)}
            else:
                whole = in_use(self.source.directory) or (self.source.directory / RESULT).exists()
                self._over = "the run is over" if whole else "the run broke: its console is gone"

    def ask(self, op: str, **fields: Any) -> Row:
        """Ask the console for something, over a connection that stays.

        Raises:
            RemoteError: it refuses, or does not answer; or only an observer's credentials are at hand.
        """
        if self._run is None and self.source.awaited:
            raise RemoteError(f"the console of {self.name} does not answer yet")
        if self._run is None:
            raise RemoteError(f"{self.name} may only be watched with these credentials", 2)
        if self._over:
            raise RemoteError(f"{self._over}: nothing can be changed any more")
        try:
            if self._connection is None:
                self._connection = OpenConnection(self._run)
            return self._connection.ask(op, **fields)
        except RemoteError as error:
            if error.status != 2 and self._connection is not None:  # perhaps it is the connection
                self._connection.close()
                self._connection = None
            raise

    def clock(self) -> Row:
        """How time goes."""
        status, over = self._status, self._over
        text = over or status.get("clock", "waiting for the run")
        waiting = status.get("waiting", "")
        return {
            "text": text,
            "paused": text == "paused",
            "rate": 0.0 if over or text == "paused" else round(self._rate.value, 2),
            "over": bool(over),
            "waiting": "" if over or waiting == text else waiting,
            "note": self._note(),
        }

    def _note(self) -> str:
        count = self.missing.count if self._over else self.missing.lost
        lost = f"{left_out(count)}." if count else ""
        if self._over:
            return lost
        if not self._published:
            return "The publisher is gone: the run goes on, and nothing more of it is seen here."
        return lost if self.picture.placed else NOT_PLACED

    def follow(self, names: Collection[str]) -> None:
        """Bring these signals and no others into the picture. Raises KeyError: there is none of a name."""
        self.signals.follow(names)
        self.picture.follow(names)
        topics = {topic for topic in self.signals.followed if link_of(topic) is None}  # those of links come already
        for topic in self._ends.keys() - topics:
            self._ends.pop(topic)()
        for topic in topics - self._ends.keys():
            self.missing.forget(topic)
            self._ends[topic] = self._subscribe(topic)

    def close(self) -> None:
        """End."""
        self._bus.close()
        if self._connection is not None:
            self._connection.close()


def _logged_s(sample: Any) -> float | None:
    """The log time of a sample [s]; None: it is not the publisher's."""
    try:
        return unpack(sample.attachment.to_bytes()).log_ns / 1e9
    except (ValueError, AttributeError):
        return None
