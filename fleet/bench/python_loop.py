"""The baseline of what one process does: a loop of plain Python that stays as it is."""

from __future__ import annotations

import time
from statistics import median

NAME = "plain Python loop"
_ROUNDS, _PASSES = 5, 20_000


class _Point:
    __slots__ = ("x", "y")

    def __init__(self, x: float, y: float) -> None:
        self.x, self.y = x, y


def _turned(point: _Point, by: float) -> _Point:
    return _Point(point.x - by * point.y, point.y + by * point.x)


def loops_per_s() -> float:
    """Passes per second of CPU time of a loop with calls, objects and floats; the median of some rounds of some ms."""
    found = []
    for _ in range(_ROUNDS):
        began, point = time.process_time(), _Point(1.0, 0.0)
        for _ in range(_PASSES):
            point = _turned(point, 1e-4)
        found.append(_PASSES / (time.process_time() - began))
    return median(found)
