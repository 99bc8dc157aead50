"""Delta debugging: the least part of a list that still fails.

The algorithm ddmin of Zeller and Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE Trans. Software
Eng. 28 (2002), section 3.2. It is exact where a test gives the same answer each time, as a run of a scenario does. All
parts of one size are tested side by side. Among those that fail it takes the first one, so the speed of workers changes
nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TypeVar

T = TypeVar("T")


def ddmin(items: Sequence[T], fails: Callable[[list[list[T]]], Sequence[bool]]) -> list[T]:
    """A part of `items`, in their order, that fails and needs each of its items to fail.

    Args:
        items: a list that fails.
        fails: says of each of some parts whether it fails. The empty list is asked for first.
    """
    if not items or fails([[]])[0]:
        return []
    left = list(items)
    pieces = 2
    while len(left) > 1:
        borders = [round(k * len(left) / pieces) for k in range(pieces + 1)]
        parts = [left[begin:end] for begin, end in pairwise(borders)]
        rests = [left[:begin] + left[end:] for begin, end in pairwise(borders)]
        # With two pieces each rest is the other part.
        found = _first(parts, fails)
        if found is not None:
            left, pieces = found, 2
        elif pieces > 2 and (found := _first(rests, fails)) is not None:
            left, pieces = found, pieces - 1
        elif pieces < len(left):
            pieces = min(2 * pieces, len(left))
        else:
            break
    return left


def _first(parts: list[list[T]], fails: Callable[[list[list[T]]], Sequence[bool]]) -> list[T] | None:
    return next((part for part, failed in zip(parts, fails(parts), strict=True) if failed), None)
