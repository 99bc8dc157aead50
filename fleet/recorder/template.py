"""A protobuf message with changing doubles: it is encoded once, then new doubles are put in their places."""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct, pack
from typing import Any

from fleet.logs.schemas import varint


class Template:
    """The encoded message that a function makes of a number of doubles, without making it.

    Protobuf leaves out zeros, which changes the lengths before them: where a value is zero, the function is called.
    """

    def __init__(self, make: Callable[..., Any], count: int) -> None:
        """Find the places of the doubles. `make` gives a protobuf message with each of its `count` arguments in one
        field, in the order of the fields.
        """
        self._make = make
        marks = [0.1234567 * (k + 1) for k in range(count)]
        rest = make(*marks).SerializeToString()
        layout, self._parts = "<", []
        for mark in marks:
            constant, rest = rest.split(pack("<d", mark))
            layout += f"{len(constant)}sd"
            self._parts += [constant, mark]
        self._parts.append(rest)
        self._pack = Struct(f"{layout}{len(rest)}s").pack

    def __call__(self, *values: float) -> bytes:
        """The encoded message."""
        if 0.0 in values:
            return bytes(self._make(*values).SerializeToString())
        parts = self._parts.copy()
        parts[1::2] = values
        return self._pack(*parts)


def field(tag: bytes, data: bytes) -> bytes:
    """A field that holds an encoded message, or several that were cut between fields, as long as the numbers of the
    fields ascend.
    """
    return tag + varint(len(data)) + data
