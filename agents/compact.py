"""A state message in 15 bytes, for modems that send 80 bits a second.

120 bits, most significant first:

| bits | field | range | step |
|---|---|---|---|
| 2 | version, 1 | | |
| 10 | sender, vehicle number | 0 to 1023 | 1 |
| 13 | round of the state, modulo 8192 | | 1 round |
| 18, 18, 16 | position x, y, z, NED | x, y within 6553.55 m, z within 1638.35 m | 5 cm |
| 9, 9, 9 | velocity over ground, NED | within 2.55 m/s | 1 cm/s |
| 16 | CRC-16/CCITT (polynomial 0x1021, first 0xffff) of the bytes before | | |

Signed numbers are two's complement of the number of steps, rounded to the nearest. So the error is at most half a step
per axis, 2.5 cm and 5 mm/s. The smallest value of each range is not used. The receiver knows the round period and its
own time, so 8192 rounds say which round is meant as long as a message is younger than that. The age of a state is
therefore exact, as in the full message. A clock that is not right shows other times at a round than whole
rounds: the message then has the nearest one, so an age is wrong by half a round at most.

The CRC finds every error of one or two bits and every burst of up to 16, and misses one in 65536 of the others.
"""

from __future__ import annotations

from binascii import crc_hqx

from agents.errors import AgentError, PayloadError
from agents.payload import StateMessage

VERSION = 1
SIZE = 15
PER_METRE = 20  # steps of position; dividing by whole numbers gives the double nearest to the decimal number
PER_MPS = 100  # steps of velocity in 1 m/s
ROUNDS = 8192

_POSITION_BITS = (18, 18, 16)
_VELOCITY_BITS = (9, 9, 9)
_NAMES = ("x", "y", "z", "the velocity along x", "the velocity along y", "the velocity along z")


class OutOfRange(AgentError):
    """A state that does not fit into the message."""


def encode(message: StateMessage, round_ticks: int) -> bytes:
    """The 15 bytes of a state message that was sampled at a round tick. Raises OutOfRange if position [m, NED],
    velocity [m/s, NED] or vehicle number is beyond the range of its field.
    """
    if not 0 <= message.sender < 1024:
        raise OutOfRange(f"vehicle {message.sender} is beyond 1023")
    bits = (VERSION << 10 | message.sender) << 13 | (message.sent_tick + round_ticks // 2) // round_ticks % ROUNDS
    scales = (PER_METRE,) * 3 + (PER_MPS,) * 3
    values = (*message.position, *message.velocity)
    for name, value, scale, width in zip(_NAMES, values, scales, _POSITION_BITS + _VELOCITY_BITS, strict=True):
        most = (1 << width - 1) - 1
        if abs(value * scale) >= most + 1 or abs(number := round(value * scale)) > most:
            raise OutOfRange(f"{name} is {value:.4g}, beyond {most / scale:.7g}")
        bits = bits << width | number & (1 << width) - 1
    body = bits.to_bytes(SIZE - 2, "big")
    return body + crc_hqx(body, 0xFFFF).to_bytes(2, "big")


def decode(data: bytes, now: int, round_ticks: int, ahead: int = 0) -> StateMessage:
    """The state message in `data`, received at tick `now` of the receiver's clock; the sender's may be up to `ahead`
    ticks ahead, at most half of `ROUNDS` rounds. Raises PayloadError: wrong length, bad checksum or unknown version.
    """
    if len(data) != SIZE:
        raise PayloadError("length", f"expected {SIZE} bytes, got {len(data)}")
    body, checksum = data[:-2], int.from_bytes(data[-2:], "big")
    if crc_hqx(body, 0xFFFF) != checksum:
        raise PayloadError("checksum", f"the CRC-16 of the content is not {checksum:#06x}")
    bits = int.from_bytes(body, "big")
    numbers: list[int] = []
    for width in reversed(_POSITION_BITS + _VELOCITY_BITS):
        number = bits & (1 << width) - 1
        numbers.append(number - (1 << width) if number >> width - 1 else number)
        bits >>= width
    vz, vy, vx, z, y, x = numbers
    round_number, sender, version = bits & ROUNDS - 1, bits >> 13 & 1023, bits >> 23
    if version != VERSION:
        raise PayloadError("version", f"expected version {VERSION}, got {version}")
    newest = now // round_ticks + min(-(-ahead // round_ticks), ROUNDS // 2)
    sampled = newest - (newest - round_number) % ROUNDS
    if sampled < 0:  # no round of this run: it becomes one to come, which the receiver refuses
        sampled += ROUNDS
    return StateMessage(
        sender,
        sampled * round_ticks,
        (x / PER_METRE, y / PER_METRE, z / PER_METRE),
        (vx / PER_MPS, vy / PER_MPS, vz / PER_MPS),
    )
