"""The signals that end a command: SIGINT (Ctrl-C), SIGTERM, and SIGHUP when its terminal closes.

They can be deferred, because an exception in the middle of a write would leave half a record in a file. Children have
SIGHUP blocked like SIGINT: a shell sends it to the whole group, and a world that dies of it would cut the log.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
INTERRUPTED, HUNG_UP = 130, 129  # exit statuses; 128 + the signal's number, as shells count


class HungUp(KeyboardInterrupt):
    """The terminal was closed."""


def ending(number: int) -> KeyboardInterrupt:
    return HungUp() if number == signal.SIGHUP else KeyboardInterrupt()


def ending_status(error: BaseException | None) -> int:
    """The exit status of a command that such an exception ended."""
    return HUNG_UP if isinstance(error, HungUp) else INTERRUPTED


@contextmanager
def holding_interrupts() -> Iterator[Callable[[], KeyboardInterrupt | None]]:
    """Within this block the signals raise nothing. Yields a function: the exception of the first signal that came, or
    None.
    """
    received: list[int] = []
    with _handling(lambda number, _: received.append(number)):
        yield lambda: ending(received[0]) if received else None


@contextmanager
def deferring_interrupts() -> Iterator[None]:
    """Within this block the signals raise nothing; the first that came is raised behind it."""
    received: list[int] = []
    try:
        with _handling(lambda number, _: received.append(number)):
            yield
    finally:
        if received:
            signal.raise_signal(received[0])


@contextmanager
def out_of_reach() -> Iterator[None]:
    """Start processes that signals to the whole group (Ctrl-C, the end of a terminal) do not reach, because they
    inherit the mask of this thread. Only who started the others decides how to react, also while they are still
    importing.
    """
    from multiprocessing import resource_tracker  # --help needs it not

    # The tracker is started by the first process of multiprocessing, and that lifts the block of SIGINT.
    with _block_signals(signal.SIGHUP):
        resource_tracker.ensure_running()
    with _block_signals(signal.SIGINT, signal.SIGHUP):
        yield


@contextmanager
def _block_signals(*signals: signal.Signals) -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class DeferInterrupts:
    """Within `with` blocks of this object the signals are deferred to the end of the block; blocks should be short.
    `handling`, around all blocks, installs the handlers, so that a block costs next to nothing.
    """

    def __init__(self) -> None:
        self._within = False
        self._deferred: list[int] = []

    @contextmanager
    def handling(self) -> Iterator[None]:
        """Install the handlers; outside of blocks the signals do what they did before."""
        before = {number: signal.getsignal(number) for number in ENDING}

        def handle(number: int, frame: FrameType | None) -> None:
            handler = before[signal.Signals(number)]
            if self._within:
                self._deferred.append(number)
            elif callable(handler):
                handler(number, frame)
            elif handler != signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
                signal.raise_signal(number)

        with _handling(handle):
            yield

    def __enter__(self) -> None:
        self._within = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._within = False
        if self._deferred:
            number = self._deferred[0]
            self._deferred.clear()
            signal.raise_signal(number)


@contextmanager
def _handling(handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread can handle signals
        return
    # A SIGHUP that is ignored, as `nohup` does it, stays ignored.
    handled = [n for n in ENDING if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in handled}
    try:
        yield
    finally:
        for number in before:
            # Another handler may have been installed meanwhile; then that one stays.
            if signal.getsignal(number) is handler:
                signal.signal(number, before[number])
