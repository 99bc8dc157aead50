"""Processes on a bus that is none: what comes in is given, what goes out is kept."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import pytest

from netem.errors import BusError
from netem.limits import WIRE_MESSAGE
from netem.process import NetworkProcess
from world.process import WorldProcess


class OverError(Exception):
    """Everything that was to come in has come in."""


class Nowhere:
    """A bus without zenoh: keeps what is put, and hands out what it was given."""

    def __init__(self) -> None:
        self.put: list[tuple[str, bytes]] = []
        self.queue: deque[Any] = deque()
        self.answers: dict[str, Callable[..., None]] = {}

    def publisher(self, key: str) -> Callable[[bytes], None]:
        def put(data: bytes) -> None:
            if len(data) > WIRE_MESSAGE.bytes:
                raise BusError(f"a message of {len(data)} bytes on {key}: the transport carries {WIRE_MESSAGE.bytes}")
            self.put.append((key, data))

        return put

    def subscribe(self, key: str, handler: Any) -> None: ...

    def answer(self, key: str, handler: Any) -> None:
        self.answers[key] = handler

    def token(self, key: str) -> None: ...

    def watch_tokens(self, key: str, handler: Any) -> None: ...

    def channel(self, key: str, capacity: int = 0) -> Nowhere:
        return self

    def stamped_queue(self, key: str) -> Nowhere:
        return self

    def get(self, timeout: float | None = None) -> Any:
        if not self.queue:
            raise OverError
        return self.queue.popleft()

    def qsize(self) -> int:
        return len(self.queue)

    def poll(self) -> Any:
        return self.queue.popleft() if self.queue else None


def serve(process: WorldProcess | NetworkProcess[Any]) -> None:
    with pytest.raises(OverError):
        process.serve()
