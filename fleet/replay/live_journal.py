"""A live run's journal for a reader that looks at it now and then. Messages wait until the reader takes them.

The publisher is a process of its own, so nothing here can hold the run up. Messages for which the queue has no room are
left out and counted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Event
from typing import Any, NamedTuple

import msgpack

from fleet.errors import FleetError
from fleet.replay.observed import Observed
from fleet.replay.topics import unpack
from netem.errors import BusError
from netem.wire.credentials import Credentials
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus, place_of


class Missing:
    """Counts what did not come of the topics that are subscribed to, from the first message of each that came.

    Each sample says which place its message has in its topic (zenoh's source information), and at the end the
    publisher says on a key of its own how many messages each topic had: a MessagePack map.
    """

    def __init__(self) -> None:
        self._next: dict[str, int] = {}  # the place that comes next, by topic
        self._gaps: dict[str, int] = {}  # by topic, because each topic has a thread of its own
        self._totals: dict[str, int] = {}  # told at the end

    def came(self, topic: str, place: int | None) -> None:
        """Note a message. If the publisher does not number them, none counts as missing."""
        if place is None:
            return
        self._gaps[topic] = self._gaps.get(topic, 0) + place - self._next.get(topic, place)
        self._next[topic] = place + 1

    def forget(self, topic: str) -> None:
        """Nobody subscribes to a topic any more; what it lost stays counted."""
        self._next.pop(topic, None)

    def end(self, data: bytes) -> None:
        """The publisher's last sample; one of another form is ignored."""
        try:
            self._totals = {str(topic): int(count) for topic, count in msgpack.unpackb(data).items()}
        except Exception:  # msgpack raises half a dozen unrelated types for bad bytes
            self._totals = {}

    def of(self, topic: str) -> int:
        return self._gaps.get(topic, 0) + self._to_come(topic)

    @property
    def lost(self) -> int:
        """How many messages did not come while later ones of their topics did."""
        return sum(list(self._gaps.values()))

    @property
    def to_come(self) -> int:
        """How many are left until the end, once it was told."""
        return sum(map(self._to_come, list(self._next)))

    @property
    def count(self) -> int:
        return self.lost + self.to_come

    def _to_come(self, topic: str) -> int:
        return max(0, self._totals[topic] - self._next[topic]) if topic in self._totals and topic in self._next else 0


def left_out(count: int) -> str:
    messages = "1 message was" if count == 1 else f"{count} messages were"
    return f"{messages} left out on the way here: more was published than this machine could take"


def pack_counts(counts: dict[str, int]) -> bytes:
    """The publisher's last sample: how many messages each topic had."""
    data: bytes = msgpack.packb(counts)
    return data


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
        self._came.wait(limit_s)

    def take(self) -> list[JournalMessage]:
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
        self.bus.close()
