"""The console's input: one queue of events, filled by the threads of zenoh and by the watcher of processes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from enum import StrEnum
from queue import Empty, SimpleQueue
from typing import Any

from netem.wire.messages import Frames, Hello, LinkReport


class EventKind(StrEnum):
    """The kinds of event, and what comes with each."""

    FRAME = "frame"  # bytes: states from the world
    LINKS = "links"  # bytes: fates of packets from netem
    NOTE = "note"  # (role, bytes)
    EXIT = "exit"  # `Exit`: a process ended
    OPERATION = "operation"  # (bytes, Respond): a request of an operator
    TOKEN = "token"  # (vehicle, bool): the liveliness token of an external agent appeared or disappeared
    ROUTER_LOST = "lost"  # endpoint of the router that is there already: the link to it ended


EXPECTED: dict[EventKind, tuple[type, ...]] = {
    EventKind.FRAME: (Frames, Hello),
    EventKind.LINKS: (LinkReport, Hello),
}


class EventQueue:
    """Events in the order of their arrival. Every thread may `put`; the console's main thread takes."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[tuple[EventKind, Any]] = SimpleQueue()

    def put(self, kind: EventKind, data: Any) -> None:
        self._queue.put((kind, data))

    def take(self, timeout_s: float) -> Iterator[tuple[EventKind, Any]]:
        """The next event and all further events that are there already; wait at most this long for the first."""
        try:
            yield self._queue.get(timeout=max(0.0, timeout_s))
            while True:
                yield self._queue.get_nowait()
        except Empty:
            return

    def take_for(self, duration_s: float) -> Iterator[tuple[EventKind, Any]]:
        """Every event that arrives within so long."""
        deadline = time.monotonic() + duration_s
        while (left_s := deadline - time.monotonic()) > 0:
            yield from self.take(left_s)
