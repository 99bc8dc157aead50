"""A state message that says how sure its sender is of its position, in 42 bytes.

| bytes | type | field | unit |
|---|---|---|---|
| 0 | u8 | version, 2; a state message of another kind begins with another | |
| 1-2 | u16 | sender, vehicle number | |
| 3-6 | u32 | sent_tick, tick at which the state was sampled | tick |
| 7-18 | 3 i32 | position x, y, z | mm, NED |
| 19-24 | 3 i16 | velocity over ground | mm/s, NED |
| 25-36 | 3 f32 | covariance of north and east: nn, ne, ee | m^2 |
| 37 | u8 | 1: the position comes from own instruments alone, which had a fix of late; otherwise 0 | |
| 38-41 | u32 | CRC-32 (zlib) of bytes 0-37 | |

Little-endian, no padding. Position and velocity are rounded to the nearest step.
"""

from __future__ import annotations

from math import isfinite
from struct import Struct
from typing import NamedTuple
from zlib import crc32

from agents.compact import OutOfRange
from agents.errors import PayloadError
from agents.payload import StateMessage

VERSION = 2
_BODY = Struct("<BHI3i3h3fB")
_WHOLE = Struct("<BHI3i3h3fBI")
SIZE = _WHOLE.size
_MOST_M2 = 1e12  # the largest variance; with more the squares in a filter may overflow
_FIRST = bytes((VERSION,))


class LocatedMessage(NamedTuple):
    """The decoded content of one payload."""

    state: StateMessage
    covariance: tuple[float, float, float]  # nn, ne, ee of north and east [m^2]
    fixed: bool  # true: the place is by own instruments alone, which had a fix of late


def is_located(data: bytes) -> bool:
    """Whether a payload is a state message of this kind, by its length and its first byte."""
    return len(data) == SIZE and data[:1] == _FIRST


def encode(message: LocatedMessage) -> bytes:
    """The bytes of a message. Raises OutOfRange: position, velocity, tick or vehicle number is beyond the range of its
    field."""
    state, covariance, fixed = message
    place = [round(1000.0 * value) for value in state.position]
    speed = [round(1000.0 * value) for value in state.velocity]
    if max(map(abs, place)) >= 2**31:
        raise OutOfRange(f"a position of {state.position} m is beyond 2147 km")
    if max(map(abs, speed)) >= 2**15:
        raise OutOfRange(f"a velocity of {state.velocity} m/s is beyond 32.7 m/s")
    if not 0 <= state.sender < 2**16 or not 0 <= state.sent_tick < 2**32:
        raise OutOfRange(f"vehicle {state.sender} at tick {state.sent_tick} is beyond 65535, or 2^32")
    nn, ne, ee = (max(-_MOST_M2, min(_MOST_M2, value)) for value in covariance)
    body = _BODY.pack(VERSION, state.sender, state.sent_tick, *place, *speed, nn, ne, ee, fixed)
    return body + crc32(body).to_bytes(4, "little")


def decode(data: bytes) -> LocatedMessage:
    """The message in `data`. Raises PayloadError: wrong length, bad checksum, unknown version, or a covariance that is
    none."""
    if len(data) != SIZE:
        raise PayloadError("length", f"expected {SIZE} bytes, got {len(data)}")
    version, sender, sent_tick, x, y, z, vx, vy, vz, nn, ne, ee, fixed, checksum = _WHOLE.unpack(data)
    if crc32(data[:-4]) != checksum:
        raise PayloadError("checksum", f"the CRC-32 of the content is not {checksum:#010x}")
    if version != VERSION:
        raise PayloadError("version", f"expected version {VERSION}, got {version}")
    # Single precision rounds the parts apart: a little more than a correlation of 1 is one.
    if not (isfinite(nn + ne + ee) and 0.0 <= nn <= _MOST_M2 and 0.0 <= ee <= _MOST_M2 and ne * ne <= 1.001 * nn * ee):
        raise PayloadError("not_finite", f"covariance {(nn, ne, ee)}")
    position, velocity = (x / 1000.0, y / 1000.0, z / 1000.0), (vx / 1000.0, vy / 1000.0, vz / 1000.0)
    return LocatedMessage(StateMessage(sender, sent_tick, position, velocity), (nn, ne, ee), fixed == 1)
