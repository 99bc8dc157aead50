"""An agent's message to its neighbours: its time, place and motion.

| bytes | type | field | unit |
|---|---|---|---|
| 0 | u8 | version, 1 | |
| 1-2 | u16 | sender, vehicle number | |
| 3-10 | u64 | sent_tick, tick at which the state was sampled | tick |
| 11-34 | 3 f64 | position x, y, z | m, NED |
| 35-58 | 3 f64 | velocity over ground | m/s, NED |
| 59-62 | u32 | CRC-32 (zlib) of bytes 0-58 | |

Little-endian, no padding. The checksum is there because the network may flip bits, and a flipped bit of a
double decodes to another plausible double.
"""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple
from zlib import crc32

from agents.errors import PayloadError
from world.vectors import Vec3

VERSION = 1
# The largest sum of all numbers [m, m/s]. 10^155 is finite, but its square is not: this bound keeps each sum and square
# finite. The codec has the bound, and not each law, so it protects the laws of users, too.
MAX_SUM = 1e9
CAUSES = ("length", "checksum", "version", "not_finite")

_BODY = Struct("<BHQ6d")
_WHOLE = Struct("<BHQ6dI")
SIZE = _WHOLE.size


class StateMessage(NamedTuple):
    """The decoded content of one payload."""

    sender: int
    sent_tick: int
    position: Vec3  # m, NED
    velocity: Vec3  # m/s over ground, NED


def encode(message: StateMessage) -> bytes:
    """The 63 bytes of a state message."""
    body = _BODY.pack(VERSION, message.sender, message.sent_tick, *message.position, *message.velocity)
    return body + crc32(body).to_bytes(4, "little")


def decode(data: bytes) -> StateMessage:
    """The state message in `data`. Raises PayloadError for a wrong length, bad checksum, unknown version, or a number
    that is not finite or beyond any sea.
    """
    if len(data) != SIZE:
        raise PayloadError("length", f"expected {SIZE} bytes, got {len(data)}")
    version, sender, sent_tick, x, y, z, vx, vy, vz, checksum = _WHOLE.unpack(data)
    if crc32(data[:-4]) != checksum:
        raise PayloadError("checksum", f"the CRC-32 of the content is not {checksum:#010x}")
    if version != VERSION:
        raise PayloadError("version", f"expected version {VERSION}, got {version}")
    # False for NaN, too.
    if not abs(x) + abs(y) + abs(z) + abs(vx) + abs(vy) + abs(vz) <= MAX_SUM:
        raise PayloadError("not_finite", f"position {(x, y, z)}, velocity {(vx, vy, vz)}")
    return StateMessage(sender, sent_tick, (x, y, z), (vx, vy, vz))
