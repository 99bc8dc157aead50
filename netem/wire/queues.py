"""Messages that wait: in order, with the time of their arrival, and never more of one key or sender than a quota."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from queue import Empty, SimpleQueue
from threading import Lock
from time import monotonic_ns
from typing import Any

from netem.limits import RELAY_WAITING


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


_MOST_KINDS = 1000  # kinds of messages that did not fit and are not taken yet


class Inlet:
    """The way of one sender into a queue that others use, too: what waits there is bounded, and what does not fit is
    counted. Several threads let in, and one takes out.
    """

    def __init__(self, put: Callable[[Any], None]) -> None:
        """`put`: of the queue. What needs no bounds may call it, too."""
        self.put = put
        self._lock = Lock()
        self._waiting = self._bytes = 0
        self._unfit: Counter[Hashable] = Counter()

    def offer(self, item: Any, size: int, name: Callable[[], Hashable]) -> None:
        """Put an item of `size` bytes, or count it by its name: too much waits."""
        with self._lock:
            if self._waiting and (self._waiting >= RELAY_WAITING.items or self._bytes + size > RELAY_WAITING.bytes):
                what = name() if len(self._unfit) < _MOST_KINDS else None
                self._unfit[what] += 1
                return
            self._waiting += 1
            self._bytes += size
            self.put(item)

    def release(self, size: int) -> None:
        """An item that waited was taken out."""
        with self._lock:
            self._waiting -= 1
            self._bytes -= size

    def unfit(self) -> Counter[Hashable]:
        """What did not fit since the last call, by name; None counts those beyond the most names."""
        if not self._unfit:
            return Counter()
        with self._lock:
            found, self._unfit = self._unfit, Counter()
        return found


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
