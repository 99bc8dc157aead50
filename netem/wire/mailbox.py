"""The mailbox of each process of a run: notes to the console, a count of rejects, and for who must not let senders
wait a queue that zenoh's threads fill.

A zenoh callback runs on a receive thread, so all it does is to put what came into the queue; the process's main
thread takes it out, one item at a time. Only netem in lockstep touches its core on another thread, too, under a lock.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from queue import SimpleQueue
from time import monotonic
from typing import NamedTuple

from netem.errors import MalformedMessage, OutOfPlace
from netem.wire.bus import Bus, Respond
from netem.wire.codec import encode
from netem.wire.keys import tail, vehicle_of
from netem.wire.messages import Note
from netem.wire.queues import Quota

log = logging.getLogger(__name__)


class Item(NamedTuple):
    """Something that came in: a put (`respond` is None) or a query."""

    key: str
    data: bytes
    respond: Respond | None


class Mailbox:
    """The queue of one process, with the bus that feeds it."""

    def __init__(self, bus: Bus, role: str, note_key: str) -> None:
        """Make the queue; `subscribe` and `answer` fill it. `note_key`: key expression of the notes to the console."""
        self.bus = bus
        self.role = role
        self.queue: SimpleQueue[Item] = SimpleQueue()
        self.rejected: Counter[str] = Counter()
        self._quota = Quota()
        self._note = bus.publisher(note_key)

    def subscribe(self, key: str) -> None:
        """Queue every put on `key`; what exceeds the quota of a key is dropped and counted, so that no sender waits."""
        put, quota = self.queue.put, self._quota

        def receive(k: str, data: bytes) -> None:
            if not quota.admit(k):
                self.rejected[f"{tail(k)}: flood"] += 1
                return
            put(Item(k, data, None))

        self.bus.subscribe(key, receive)

    def take(self, timeout_s: float | None = None) -> Item:
        """Wait for the next item. Raises queue.Empty if there was none in time."""
        item = self.queue.get(timeout=timeout_s)
        if item.respond is None:
            self._quota.release(item.key)
        return item

    def answer(self, key: str) -> None:
        put = self.queue.put
        self.bus.answer(key, lambda k, data, respond: put(Item(k, data, respond)))

    def reject(self, key: str, tick: int, error: MalformedMessage | OutOfPlace) -> None:
        """Count and drop a message; the first of its kind from a key is also sent to the console as a note."""
        subject = vehicle_of(key)
        kind = f"{tail(key)}: {type(error).__name__}"
        self.rejected[kind] += 1
        if self.rejected[kind] == 1:
            log.warning("rejected on %s: %s", key, error)
            self.note(subject, tick, f"rejected on {key}: {error}")

    def note(self, subject: int, tick: int, text: str) -> None:
        """Send the console a line for the operator: `subject` is a vehicle, or 0."""
        self._note(encode(Note(self.role, subject, tick, text[:2000])))


class Probes:
    """Bounds how many probes of each agent are answered, so that a flood of them makes no flood of answers."""

    BURST, PER_S = 60, 60.0  # an agent that gets ready asks after 20 ms, then more rarely

    def __init__(self, now: Callable[[], float] = monotonic) -> None:
        self._now = now
        self._left: dict[int, tuple[float, float]] = {}  # by agent: how many, at what time

    def spend(self, i: int) -> None:
        """Count a probe of agent i. Raises OutOfPlace if the agent has sent more than BURST, and more than PER_S a
        second since.
        """
        now = self._now()
        left, since = self._left.get(i, (float(self.BURST), now))
        left = min(float(self.BURST), left + (now - since) * self.PER_S)
        self._left[i] = max(0.0, left - 1.0), now
        if left < 1.0:
            raise OutOfPlace("hello", f"at most {self.PER_S:g} probes a second", "more")
