"""The messages of one protocol among what an agent receives."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from agents.api import Delivery, PayloadError, unpack


def valid_messages(
    kind: str, deliveries: Iterable[Delivery], valid: Callable[[Any, Delivery], bool]
) -> tuple[list[tuple[Delivery, Any]], int]:
    """The valid messages of one kind. `kind`: the kind of message, as given to `agents.api.pack`. `valid`: returns
    whether a message of this protocol can have these values. Returns the deliveries with their values, in order; and
    the number of messages that are damaged or not valid."""
    found, refused = [], 0
    for delivery in deliveries:
        try:
            values = unpack(kind, delivery.payload)
        except PayloadError as error:
            refused += error.cause != "version"
            continue
        if valid(values, delivery):
            found.append((delivery, values))
        else:
            refused += 1
    return found, refused


def is_real(value: Any, most: float) -> bool:
    """Whether a value of a message is a number of at most this size."""
    return type(value) in (int, float) and -most <= value <= most


def is_count(value: Any, most: int) -> bool:
    """Whether a value of a message is an integer from 0 to this one."""
    return type(value) is int and 0 <= value <= most
