"""Messages that wait: in order, with the time of their arrival, and never more of one key or sender than a quota."""

from __future__ import annotations

from collections import Counter
from queue import Empty, SimpleQueue
from time import monotonic_ns
from typing import Any


class PutQueue:
    """The puts on a key expression, in order."""

    def __init__(self, subscriber: Any) -> None:
        self._subscriber = subscriber

    def get(self) -> tuple[str, bytes]:
        """The next (key, bytes); waits for it."""
        sample = self._subscriber.recv()
        return str(sample.key_expr), sample.payload.to_bytes()

    def poll(self) -> tuple[str, bytes] | None:
        """The next (key, bytes), or None when there is none yet."""
        sample = self._subscriber.try_recv()
        return None if sample is None else (str(sample.key_expr), sample.payload.to_bytes())


MOST_WAITING = 1000  # puts on one key of senders that must not wait; a healthy fleet has a few


class Quota:
    """How many may wait per key, so that a flood of one takes no room from the others, nor all the memory.

    One thread lets in and one takes out; each writes a count of its own.
    """

    def __init__(self, most: int = MOST_WAITING) -> None:
        self._most = most
        self._came: Counter[str] = Counter()
        self._taken: Counter[str] = Counter()

    def admit(self, key: str) -> bool:
        """Whether there is room for one more, which then waits."""
        if self._came[key] - self._taken[key] >= self._most:
            return False
        self._came[key] += 1
        return True

    def release(self, key: str) -> None:
        """One that waited was taken out."""
        self._taken[key] += 1


class Stamped:
    """The messages of a key expression in their order, each with its time of arrival [ns, CLOCK_MONOTONIC]."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[tuple[str, bytes, int]] = SimpleQueue()
        self._quota = Quota()
        self.flooded: Counter[str] = Counter()  # puts by key that were dropped because the quota was used up

    def put(self, key: str, data: bytes) -> None:
        """Called on a zenoh thread."""
        if self._quota.admit(key):
            self._queue.put((key, data, monotonic_ns()))
        else:
            self.flooded[key] += 1

    def get(self, timeout_s: float | None = None) -> tuple[str, bytes, int] | None:
        """The next (key, bytes, time); waits for it, or None when none came in time."""
        try:
            item = self._queue.get(timeout=timeout_s)
        except Empty:
            return None
        self._quota.release(item[0])
        return item

    def poll(self) -> tuple[str, bytes, int] | None:
        """The next (key, bytes, time), or None when there is none yet."""
        return self.get(0.0) if self._queue.qsize() else None

    def __len__(self) -> int:
        return self._queue.qsize()
