"""Waiting without sleeping: for a condition, with a limit, and with a word on what did not come."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from time import monotonic
from typing import TypeVar

T = TypeVar("T")

_NEVER = Event()
POLL_S = 0.01


def wait_for(condition: Callable[[], T], limit: float, what: str = "the condition") -> T:
    """The first true value of `condition`, asked again and again.

    Raises:
        AssertionError: none within `limit` seconds.
    """
    deadline = monotonic() + limit
    while not (value := condition()):
        assert monotonic() < deadline, f"{what} did not come within {limit:g} s"
        _NEVER.wait(POLL_S)
    return value
