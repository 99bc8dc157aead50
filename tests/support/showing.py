"""A bridge to viewers that goes on in a thread while a test talks to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from threading import Thread

from rich.console import Console

from fleet.terminal.keyboard import Key, Keyboard
from fleet.terminal.status_line import StatusLine


class Over(Exception):
    """The test is over."""


class Fingers(Keyboard):
    """A keyboard that a test presses."""

    def __init__(self) -> None:
        super().__init__()
        self.presses: SimpleQueue[Key | None] = SimpleQueue()

    def read(self, timeout_s: float) -> list[Key]:
        try:
            key = self.presses.get_nowait()
        except Empty:
            return []
        if key is None:
            raise Over
        return [key]


def quiet_line() -> StatusLine:
    return StatusLine(Console(quiet=True), quiet=True)


@contextmanager
def going_on(run: Callable[[Fingers, StatusLine], None]) -> Iterator[Fingers]:
    """Call `run` in a thread until the block ends; what it raises is raised here."""
    fingers = Fingers()
    raised: list[BaseException] = []

    def go() -> None:
        try:
            run(fingers, quiet_line())
        except Over:
            pass
        except BaseException as error:
            raised.append(error)

    thread = Thread(target=go)
    thread.start()
    try:
        yield fingers
    finally:
        fingers.presses.put(None)
        thread.join(60)
    assert not thread.is_alive()
    if raised:
        raise raised[0]
