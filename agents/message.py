"""Payloads of protocols of one's own: plain values of a named kind, with a checksum.

| bytes | type | field |
|---|---|---|
| 0 | u8 | version, 0x81; a state message begins with another |
| 1 | u8 | n, length of the kind |
| 2 .. n+1 | ASCII | kind: which protocol, and which of its messages |
| n+2 .. | MessagePack | the values |
| the last 4 | u32, little-endian | CRC-32 (zlib) of all before |

Several kinds may travel side by side, also with the state message of `agents.payload`. The network may flip bits, and a
neighbour may send anything: what is not of the kind, damaged, or holds a number that is not finite is refused.
"""

from __future__ import annotations

from itertools import chain
from math import isfinite
from typing import Any
from zlib import crc32

import msgspec

from agents.errors import PayloadError

VERSION = 0x81
_DEEPEST = 16  # lists and maps within each other
_SIMPLE = frozenset({int, bool, str, bytes, type(None)})
_decode = msgspec.msgpack.Decoder().decode


def pack(kind: str, values: Any) -> bytes:
    """Make a payload of plain values.

    Args:
        kind: the protocol and the kind of message; 1 to 40 characters, ASCII.
        values: None, bool, int, float, str, bytes, and lists and dicts of them; numbers must be finite.

    Returns:
        The payload, with a checksum; `unpack` gives the values back.

    Raises:
        ValueError: the kind is too long, or no ASCII; a number is not finite, or a value is none of these.
    """
    if not 1 <= len(kind) <= 40:
        raise ValueError(f"expected a kind of 1 to 40 characters, got {len(kind)}")
    if not _plain(values):
        text = f"expected plain values with finite numbers, in {_DEEPEST} lists at most"
        raise ValueError(f"{kind}: {text}, got {values!r:.80}")
    try:
        content = msgspec.msgpack.encode(values)
    except (TypeError, OverflowError) as error:  # a float of numpy, an integer beyond 64 bits
        raise ValueError(f"{kind}: {error}") from None
    body = bytes((VERSION, len(kind))) + kind.encode("ascii") + content
    return body + crc32(body).to_bytes(4, "little")


def unpack(kind: str, payload: bytes) -> Any:
    """Read the payload of another vehicle, which may hold anything.

    Args:
        kind: the protocol and the kind of message that is expected.
        payload: bytes as they came.

    Returns:
        The values that `pack` was given; tuples have become lists.

    Raises:
        PayloadError: it is of another kind or protocol (cause `version`), damaged (`length`, `checksum`), or holds a
            number that is not finite (`not_finite`).
    """
    begin = 2 + len(kind)
    if payload[:begin] != bytes((VERSION, len(kind))) + kind.encode("ascii"):
        raise PayloadError("version", f"expected a message of kind {kind}")
    if len(payload) < begin + 5:
        raise PayloadError("length", f"expected {begin + 5} bytes or more, got {len(payload)}")
    checksum = int.from_bytes(payload[-4:], "little")
    if crc32(payload[:-4]) != checksum:
        raise PayloadError("checksum", f"the CRC-32 of the content is not {checksum:#010x}")
    try:
        values = _decode(payload[begin:-4])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise PayloadError("length", f"no MessagePack: {error!s:.80}") from None
    if not _plain(values):
        raise PayloadError("not_finite", f"{values!r:.80}")
    return values


def _plain(values: Any, depth: int = 0) -> bool:
    """Whether these are plain values, every number is finite, and nothing is nested too deep."""
    if isinstance(values, list | tuple):
        if depth >= _DEEPEST:
            return False
        # A call for each value would cost more than the rest of a message.
        kinds = set(map(type, values))
        if kinds <= _SIMPLE:
            return True
        if kinds == {list}:
            return _plain(list(chain.from_iterable(values)), depth + 1)
        return all(_plain(value, depth + 1) for value in values)
    if isinstance(values, float):
        return isfinite(values)
    if isinstance(values, dict):
        return _plain([*values, *values.values()], depth)
    return values is None or isinstance(values, int | str | bytes)
