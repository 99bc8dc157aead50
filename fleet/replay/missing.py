"""The messages that a subscriber to a live run's journal did not get.

They were dropped on their way, because the subscriber or a router was too slow.

Each sample says which place its message has in its topic (zenoh's source information), and at the end the publisher
says on a key of its own how many messages each topic had: a MessagePack map.
"""

from __future__ import annotations

import msgpack


class Missing:
    """Counts what did not come of the topics that are subscribed to, from the first message of each that came."""

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
        self._totals = _unpack_counts(data)

    def of(self, topic: str) -> int:
        """How many messages of a topic did not come."""
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
        """How many messages did not come."""
        return self.lost + self.to_come

    def _to_come(self, topic: str) -> int:
        return max(0, self._totals[topic] - self._next[topic]) if topic in self._totals and topic in self._next else 0


def left_out(count: int) -> str:
    """A sentence about messages that did not come."""
    messages = "1 message was" if count == 1 else f"{count} messages were"
    return f"{messages} left out on the way here: more was published than this machine could take"


def pack_counts(counts: dict[str, int]) -> bytes:
    """The publisher's last sample: how many messages each topic had."""
    data: bytes = msgpack.packb(counts)
    return data


def _unpack_counts(data: bytes) -> dict[str, int]:
    try:
        counts = msgpack.unpackb(data)
        return {str(topic): int(count) for topic, count in counts.items()}
    except Exception:  # msgpack raises half a dozen unrelated types for bad bytes
        return {}
