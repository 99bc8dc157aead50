"""Which kinds of payload the packets of a log carry, and how many of each.

| kind | what it is |
|---|---|
| the name that `agents.api.pack` was given | a message of a protocol of one's own |
| `state message` | where a vehicle was and how it moved: `agents.payload`, `agents.compact` |
| `other bytes` | everything else, such as what an agent encodes itself |
| `damaged` | the link changed the payload, and what is left names no kind that arrived whole |

A kind is read from the first bytes and the length; no checksum is computed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from agents import compact, message, payload
from netem.cause import Cause

if TYPE_CHECKING:
    from fleet.logs.topic import Topic

STATE, OTHER, DAMAGED = "state message", "other bytes", "damaged"
_CHECKSUM = 4  # bytes at the end of a message of one's own


class KindCount(NamedTuple):
    """The packets of one kind; copies count."""

    kind: str
    packets: int
    delivered: int  # whole
    size: int  # bytes of all payloads


def kind_of(data: bytes) -> str:
    """The kind of a payload. A damaged payload may seem to be of a kind that does not exist."""
    if data[:1] == bytes((message.VERSION,)) and len(data) > 1:
        name = data[2 : 2 + data[1]]
        if 1 <= len(name) == data[1] and len(data) > 2 + len(name) + _CHECKSUM:
            text = name.decode("ascii", "replace")
            if text.isprintable() and text.isascii():
                return text
        return OTHER
    full = len(data) == payload.SIZE and data[0] == payload.VERSION
    short = len(data) == compact.SIZE and data[0] >> 6 == compact.VERSION
    return STATE if full or short else OTHER


def count_kinds(links: Iterable[Topic]) -> list[KindCount] | None:
    """The packets of some links by kind of payload, the most frequent kind first. None if the payloads were not kept,
    because the log is too large for that.
    """
    found: dict[tuple[str, bool], list[int]] = {}  # (kind, damaged) -> packets, delivered, bytes
    for topic in links:
        if not len(topic):
            continue
        if topic.too_many or "payload" not in topic:
            return None
        rows = zip(topic["payload"], topic["corrupted"], topic["fate"] == Cause.DELIVERED, strict=True)
        for data, corrupted, delivered in rows:
            counts = found.setdefault((kind_of(data), bool(corrupted)), [0, 0, 0])
            counts[0] += 1
            counts[1] += bool(delivered) and not corrupted
            counts[2] += len(data)
    whole = {kind for kind, corrupted in found if not corrupted}
    together: dict[str, list[int]] = {}
    for (kind, _), counts in found.items():
        sums = together.setdefault(kind if kind in whole else DAMAGED, [0, 0, 0])
        sums[:] = [a + b for a, b in zip(sums, counts, strict=True)]
    return sorted((KindCount(kind, *counts) for kind, counts in together.items()), key=lambda one: (-one.packets, one))
