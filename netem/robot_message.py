"""What a program of a robot that is not ours says: a put, a query, a reply, a datagram, a frame of a modem."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

PUT, DELETE, QUERY, REPLY, DATAGRAM, MODEM, PACKET = (
    "put", "delete", "query", "reply", "datagram", "modem", "packet",
)  # fmt: skip


class RobotMessage(Struct):
    """A message, query or reply of a program of a robot."""

    src: int
    kind: str
    key: str
    payload: bytes
    at_ns: int  # when the message arrived here [CLOCK_MONOTONIC]
    what: Any = None  # zenoh's own sample, query or reply, or what the process needs to hand it over
    to: int | None = None  # the only receiver; None: all neighbours
    number: int = 0  # counts messages in the order in which the relay took them
