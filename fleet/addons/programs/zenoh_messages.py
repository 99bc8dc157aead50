"""What zenoh endpoints of agents say to each other: MessagePack of a list, whose first value is the kind."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum

import msgpack


class MessageKind(IntEnum):
    """What a message is."""

    PUT = 0
    DELETE = 1
    QUERY = 2
    REPLY = 3
    END = 4  # of the replies to a query
    TOKENS = 5  # all liveliness tokens of an agent
    PART = 6  # of a message that is longer than a datagram


def puts(datagram: bytes) -> Iterator[tuple[str, bytes]]:
    """The key and the payload of what a datagram puts; none: it puts nothing, or is a part of a longer message."""
    try:
        message = msgpack.unpackb(datagram)
    except ValueError:  # who wakes the endpoint sends nothing
        return
    if isinstance(message, list) and len(message) > 2 and message[0] == MessageKind.PUT:
        yield message[1], message[2]
