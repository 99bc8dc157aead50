"""Ctrl-C and SIGTERM, kept from the middle of a write: an exception there would leave half a record in a file."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_ENDING = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def holding_interrupts() -> Iterator[Callable[[], bool]]:
    """Ctrl-C and SIGTERM raise nothing within; asked, the function that is given says whether one of them came."""
    came: list[int] = []
    with _kept(came):
        yield lambda: bool(came)


@contextmanager
def unbroken() -> Iterator[None]:
    """Ctrl-C and SIGTERM within have their effect at the end, which is to come soon."""
    came: list[int] = []
    try:
        with _kept(came):
            yield
    finally:
        for number in came[:1]:
            signal.raise_signal(number)


@contextmanager
def _kept(came: list[int]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are for the main thread alone
        return
    before = {number: signal.signal(number, lambda n, _: came.append(n)) for number in _ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
