"""The order of the tests on several workers."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain, islice
from typing import TypeVar

T = TypeVar("T")


def dealt(tests: list[T], longer: Callable[[T], object], workers: int) -> list[T]:
    """The tests so that those that take longer begin first, on all workers: each begins with one stretch of the list.

    Args:
        tests: In their own order, which the others keep.
        longer: What a test that takes longer shares with others, which stay together; None: it does not take longer.
        workers: Their number.
    """
    groups: dict[object, list[T]] = {}
    others: list[T] = []
    for test in tests:
        group = longer(test)
        (others if group is None else groups.setdefault(group, [])).append(test)
    rest, found = iter(others), list[T]()
    for worker in range(workers):
        found += chain.from_iterable(list(groups.values())[worker::workers])
        found += islice(rest, max(0, len(tests) * (worker + 1) // workers - len(found)))
    return [*found, *rest]
