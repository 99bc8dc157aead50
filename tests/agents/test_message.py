"""Payloads of protocols of one's own."""

from __future__ import annotations

from contextlib import suppress
from math import inf, nan
from typing import Any
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents import compact
from agents.errors import PayloadError
from agents.message import VERSION, pack, unpack
from agents.payload import StateMessage, encode

SCALARS = (
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False)
)
VALUES = st.recursive(
    SCALARS | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text() | st.integers(0, 9), inner, max_size=4),
    max_leaves=12,
)


@given(st.text(st.characters(max_codepoint=127), min_size=1, max_size=40), VALUES)
def test_values_come_back(kind: str, values: Any) -> None:
    payload = pack(kind, values)
    assert unpack(kind, payload) == values
    with pytest.raises(PayloadError, match="version"):
        unpack(chr((ord(kind[0]) + 1) % 128) + kind[1:], payload)


@given(VALUES, st.data())
def test_a_flipped_bit_is_noticed(values: Any, data: st.DataObject) -> None:
    payload = bytearray(pack("mine", values))
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    payload[bit // 8] ^= 1 << bit % 8
    with pytest.raises(PayloadError):
        unpack("mine", bytes(payload))


@given(st.binary(max_size=200))
def test_any_bytes_are_refused(data: bytes) -> None:
    """Also with the right beginning and checksum: then it is MessagePack or not, and nothing else is raised."""
    with pytest.raises(PayloadError):
        unpack("mine", data)
    body = bytes((VERSION, 4)) + b"mine" + data
    with suppress(PayloadError):
        pack("mine", unpack("mine", body + crc32(body).to_bytes(4, "little")))


def test_numbers_that_are_not_finite_and_depths_are_refused_on_both_sides() -> None:
    deep: Any = 1
    deep_map: Any = 1
    key: Any = 1
    for _ in range(16):
        deep, deep_map, key = [deep], {"a": deep_map}, (key,)
    assert unpack("mine", pack("mine", [*deep, *deep])) and unpack("mine", pack("mine", deep_map)) == deep_map
    for values in (nan, [1.0, inf], {"a": [-inf]}, [deep], {"a": deep_map}, {key: 1}):
        with pytest.raises(ValueError, match="plain values with finite numbers"):
            pack("mine", values)
    for inside in (b"\xcb\x7f\xf8\0\0\0\0\0\0", b"\xc7\x00\x05", b"\x91" * 20 + b"\x01", b"\x91" * 30_000 + b"\x01"):
        body = bytes((VERSION, 4)) + b"mine" + inside
        with pytest.raises(PayloadError):
            unpack("mine", body + crc32(body).to_bytes(4, "little"))
    with pytest.raises(ValueError, match="1 to 40 characters"):
        pack("", 1)
    with pytest.raises(ValueError, match="plain values"):
        pack("mine", {1j})
    with pytest.raises(ValueError, match=r"mine: .*numpy\.float64"):
        pack("mine", np.float64(1.5))
    with pytest.raises(ValueError, match="mine: "):
        pack("mine", [2**70])


def test_a_state_message_is_told_apart_by_its_first_byte() -> None:
    message = StateMessage(3, 40, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    assert VERSION not in {encode(message)[0], *(compact.encode(message, n)[0] for n in (1, 10))}
    assert all((compact.VERSION << 6) <= compact.encode(message._replace(sender=n), 1)[0] < 0x80 for n in (0, 1023))
