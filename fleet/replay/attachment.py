"""The attachment of every published sample of a journal: its times and its place.

A MessagePack array of four unsigned integers:

| field | unit | meaning |
|---|---|---|
| `log_ns` | ns of sim time | when it happened (MCAP `log_time`) |
| `publish_ns` | ns of sim time | when it was sent (MCAP `publish_time`) |
| `sequence` | 1 | the tick, or the number of the packet on its link (MCAP `sequence`) |
| `number` | 1 | its place in the log, from 0: gaps show a subscriber of all topics what was lost |
"""

from __future__ import annotations

from typing import NamedTuple

import msgpack


class Stamp(NamedTuple):
    """The times and the place of one message of a log."""

    log_ns: int
    publish_ns: int
    sequence: int
    number: int


def pack(stamp: Stamp) -> bytes:
    """The attachment's bytes."""
    data: bytes = msgpack.packb(stamp)
    return data


def unpack(data: bytes) -> Stamp:
    """The inverse of `pack`.

    Raises:
        ValueError: not such an attachment.
    """
    try:
        values = msgpack.unpackb(data)
    except Exception as error:  # msgpack raises half a dozen unrelated types for bad bytes
        raise ValueError(f"not MessagePack ({error or type(error).__name__})") from None
    if not isinstance(values, list) or len(values) != 4 or not all(type(v) is int and v >= 0 for v in values):
        raise ValueError(f"expected four unsigned integers, got {values!r:.60}")
    return Stamp(*values)
