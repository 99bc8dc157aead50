"""What ends a command: Ctrl-C, SIGTERM, and SIGHUP when its terminal closes.

All are kept from the middle of a write: an exception there would leave half a record in a file.
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
    """The exception for one of these signals."""
    return HungUp() if number == signal.SIGHUP else KeyboardInterrupt()


def ending_status(error: BaseException | None) -> int:
    """The exit status of a command that such an exception ended."""
    return HUNG_UP if isinstance(error, HungUp) else INTERRUPTED


@contextmanager
def holding_interrupts() -> Iterator[Callable[[], KeyboardInterrupt | None]]:
    """These signals raise nothing within; asked, the function that is given has the exception if one of them came."""
    came: list[int] = []
    with _handling(lambda number, _: came.append(number)):
        yield lambda: ending(came[0]) if came else None


class DeferInterrupts:
    """Within `with` blocks of this object these signals wait for the block's end, which is to come soon.

    The blocks cost next to nothing; `guarding`, around all of them, takes the signals.
    """

    def __init__(self) -> None:
        self._within = False
        self._came: list[int] = []

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """From here on signals may wait; outside of blocks they do what they did before."""
        before = {number: signal.getsignal(number) for number in ENDING}

        def arrive(number: int, frame: FrameType | None) -> None:
            handler = before[signal.Signals(number)]
            if self._within:
                self._came.append(number)
            elif callable(handler):
                handler(number, frame)
            elif handler != signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
                signal.raise_signal(number)

        with _handling(arrive):
            yield

    def __enter__(self) -> None:
        self._within = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._within = False
        if self._came:
            number = self._came[0]
            self._came.clear()
            signal.raise_signal(number)


@contextmanager
def _handling(handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are for the main thread alone
        return
    # A SIGHUP that is ignored, as `nohup` does it, stays ignored.
    taken = [n for n in ENDING if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in taken}
    try:
        yield
    finally:
        for number in before:
            # `fleet` ignores them from the first one on; that stays so.
            if signal.getsignal(number) is handler:
                signal.signal(number, before[number])
