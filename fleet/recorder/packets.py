"""The message of a packet, encoded by hand: a run has as many as its links carry, and protobuf's object costs 3 us."""

from __future__ import annotations

from math import nan
from struct import Struct

from msgspec.structs import astuple

from fleet.logs.schemas import varint
from fleet.recorder.log_file import SECOND_NS
from netem.causes import Cause
from netem.wire.messages import Fate

_double = Struct("<Bd").pack  # tag, value
_RANGE_TAGS = range(0x49, 0x70, 8)  # of five doubles, fields 9 to 13
_FATES = {cause: b"\x32" + varint(len(cause)) + cause.encode() for cause in Cause}


def packet_data(fate: Fate, tick_ns: int) -> bytes:
    """A fate as the message `Packet` of `fleet.logs.schemas.PACKET`; as in all of protobuf, zeros are left out."""
    data = b"\x08" + varint(fate.seq) if fate.seq else b""
    if fate.copy:
        data += b"\x10" + varint(fate.copy)
    if fate.sent_tick:
        data += _double(0x19, fate.sent_tick * tick_ns / SECOND_NS)
    if fate.due_tick:
        data += _double(0x21, fate.due_tick * tick_ns / SECOND_NS)
    if fate.delay_ns:
        data += _double(0x29, fate.delay_ns / SECOND_NS)
    data += _FATES[fate.cause]
    payload = fate.payload
    if payload:
        data += b"\x3a" + varint(len(payload)) + payload
    return data + b"\x40\x01" if fate.corrupted else data


def ranged_data(fate: Fate, tick_ns: int) -> bytes:
    """The same as the message `RangedPacket`, with what its receiver's modem has measured."""
    measured = fate.measured
    values = (nan,) * 5
    if measured is not None:
        range_m, sd_m, tick, distance_m = astuple(measured)
        values = (range_m, sd_m, tick * tick_ns / SECOND_NS, distance_m, range_m - distance_m)
    return packet_data(fate, tick_ns) + b"".join(map(_double, _RANGE_TAGS, values))
