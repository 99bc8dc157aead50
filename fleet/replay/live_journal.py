"""A live run's journal for a reader that looks at it now and then. Messages wait until the reader takes them.

The publisher is a process of its own, so nothing here can hold the run up. Messages for which the queue has no room are
left out and counted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Event
from typing import Any, NamedTuple

from fleet.errors import FleetError
from fleet.replay.attachment import unpack
from fleet.replay.missing import Missing
from fleet.replay.observed import Observed
from netem.errors import BusError
from netem.wire.access import Credentials
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus, place_of

MOST_WAITING = 50_000  # messages between two looks


class JournalMessage(NamedTuple):
    """A message of the journal."""

    topic: str
    log_ns: int
    data: bytes


class LiveJournal:
    """The topics of a run that somebody subscribes to."""

    def __init__(self, bus: OpenBus, keys: Keys) -> None:
        self.bus, self.keys = bus, keys
        self.missing = Missing()
        self._waiting: deque[Any] = deque(maxlen=MOST_WAITING)
        self._newest: dict[str, Any] = {}  # by key
        self._came = Event()
        bus.subscribe(keys.log_end, lambda sample: self.missing.end(sample.payload.to_bytes()))

    @classmethod
    def connect(cls, observed: Observed, name: str) -> LiveJournal:
        """Join the publisher of a run. Raises FleetError: it cannot be reached."""
        try:
            bus = OpenBus.connect(observed.endpoint, Credentials(observed.user, observed.password))
        except BusError as error:
            raise FleetError(f"the journal of {name} cannot be read: {error}", status=3) from None
        return cls(bus, Keys(observed.run))

    def subscribe(self, topic: str) -> Callable[[], None]:
        """Follow a topic, or those of a pattern of zenoh's. Returns what ends it."""
        return self.bus.subscribe(self.keys.log(topic), self.receive)

    def subscribe_newest(self, topic: str) -> None:
        """Follow the newest message of a topic, or of each of a pattern; none of the others is missing."""
        self.bus.subscribe(self.keys.log(topic), self.receive_newest)

    def receive_newest(self, sample: Any) -> None:
        """Keep a sample in place of the one before it; on a thread of zenoh."""
        self._newest[str(sample.key_expr)] = sample

    def receive(self, sample: Any) -> None:
        """Keep a sample; on a thread of zenoh."""
        self._waiting.append(sample)  # when it is full, the oldest one goes
        self._came.set()

    def wait(self, limit_s: float) -> None:
        """Until something comes, but no longer than so."""
        self._came.wait(limit_s)

    def take(self) -> list[JournalMessage]:
        """The messages that have come, in their order."""
        self._came.clear()
        waiting, found = self._waiting, []
        for _ in range(len(waiting)):
            sample = waiting.popleft()
            if (message := self._message(sample)) is not None:
                self.missing.came(message.topic, place_of(sample))
                found.append(message)
        return found

    def take_newest(self) -> list[JournalMessage]:
        """The newest message of each topic that is followed in this way, if one has come."""
        some = [self._newest.pop(key) for key in list(self._newest)]
        return [message for message in map(self._message, some) if message is not None]

    def _message(self, sample: Any) -> JournalMessage | None:
        """None: it is not the publisher's."""
        topic = str(sample.key_expr)[len(self.keys.log("")) :]
        try:
            log_ns = unpack(sample.attachment.to_bytes()).log_ns
        except (ValueError, AttributeError):
            return None
        return JournalMessage(topic, log_ns, sample.payload.to_bytes())

    def close(self) -> None:
        """End."""
        self.bus.close()
