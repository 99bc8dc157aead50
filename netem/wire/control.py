"""Control requests and their answers: maps of plain values."""

from __future__ import annotations

from typing import Any

import msgpack

from netem.errors import MalformedMessage


def request(op: str, **fields: Any) -> bytes:
    """A control request: a MessagePack map with the operation's name."""
    data: bytes = msgpack.packb({"op": op, **fields})
    return data


def read_map(data: bytes) -> dict[str, Any]:
    """A control request or answer. Raises MalformedMessage: not a MessagePack map with text keys."""
    try:
        values = msgpack.unpackb(data)
    except Exception as error:  # msgpack raises half a dozen unrelated types for bad bytes
        raise MalformedMessage("control", f"not MessagePack ({error or type(error).__name__})") from None
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise MalformedMessage("control", f"expected a map, got {values!r:.60}")
    return values
