"""The message of a packet, encoded by hand: a run has as many as its links carry, and protobuf's object costs 3 us."""

from __future__ import annotations

from struct import Struct

from fleet.logs.schemas import varint
from fleet.recorder.log_file import SECOND_NS
from netem.causes import Cause
from netem.wire.messages import Fate

_double = Struct("<Bd").pack  # tag, value
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
