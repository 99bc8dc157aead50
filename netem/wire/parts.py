"""Long messages in parts, because the transport carries no long ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

PART_BYTES = 32_000  # length of a part, well below `netem.limits.WIRE_MESSAGE`

_T = TypeVar("_T")


def split(items: Sequence[_T], size: Callable[[_T], int], limit: int) -> Iterator[tuple[Sequence[_T], bool]]:
    """Consecutive parts of `items`, each of at most `limit` bytes or a single item, with whether more follow."""
    begin = total = 0
    for index, item in enumerate(items):
        total += (one := size(item))
        if total > limit and index > begin:
            yield items[begin:index], True
            begin, total = index, one
    yield items[begin:], False


def pieces(data: bytes, limit: int) -> list[bytes]:
    """The same bytes, at most `limit` at a time; an empty list for no bytes."""
    return [data[begin : begin + limit] for begin in range(0, len(data), limit)]
