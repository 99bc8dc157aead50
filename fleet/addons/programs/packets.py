"""Packets between the nodes of programs: what an agent's payload holds, and how long it is.

A payload is as long as the packet that it stands for: the bytes of the program, and a header of IP with UDP (28 bytes,
48 of IPv6) or with TCP (40 and 60). In its room the header holds

| bytes | type | field |
|---|---|---|
| 0 .. 2 | u8 | 0x81, 1, `p`: a payload of the kind `p`, see agents/message.py |
| 3 | u8 | what follows: 0 a datagram of IPv4, 1 of IPv6, 2 a segment over IPv4, 3 over IPv6 |
| 4 .. 7 | u32 | CRC-32 (zlib) of all the rest, since the network may flip bits, and UDP and TCP have checksums, too |
| 8, 9 | u16 | the agent that it is for; 0: all |
| 10 .. 13 | u16 | its ports: from, to |
| 14 .. | | the address that it is for, 4 or 16 bytes; of a segment: its fields |

Numbers are little-endian. The address of the sender is that of its node: 10.0.0.NUMBER, or fd00::NUMBER.
"""

from __future__ import annotations

import struct
from typing import NamedTuple
from zlib import crc32

EVERYBODY = 0
_BEGIN = b"\x81\x01p"
_FIELDS = struct.Struct("<HHH")
_HEADER = {0: 28, 1: 48, 2: 40, 3: 60}
V4 = bytes(10) + b"\xff\xff"


class Datagram(NamedTuple):
    """A datagram on its way."""

    agent: int  # it is for; EVERYBODY: all
    from_port: int
    to_port: int
    to_ip: bytes  # 16 bytes; IPv4 as ::ffff:a.b.c.d
    data: bytes

    def packed(self) -> bytes:
        """The payload."""
        v6 = self.to_ip[:12] != V4
        fields = _FIELDS.pack(self.agent, self.from_port, self.to_port) + (self.to_ip if v6 else self.to_ip[12:])
        return _whole(1 if v6 else 0, fields, self.data)


class Segment(NamedTuple):
    """A segment of a stream on its way."""

    agent: int
    from_port: int
    to_port: int
    kind: int  # see streams.py
    connection: int
    sequence: int
    acknowledged: int
    window: int
    v6: bool
    data: bytes

    def packed(self) -> bytes:
        """The payload."""
        fields = _FIELDS.pack(self.agent, self.from_port, self.to_port) + _SEGMENT.pack(
            self.kind, self.connection, self.sequence, self.acknowledged, self.window
        )
        return _whole(3 if self.v6 else 2, fields, self.data)


_SEGMENT = struct.Struct("<BQIII")


def node_address(agent: int, v6: bool) -> bytes:
    """The address of a node, 16 bytes."""
    number = agent.to_bytes(2, "big")
    return b"\xfd" + bytes(13) + number if v6 else V4 + b"\x0a\x00" + number


def _whole(kind: int, fields: bytes, data: bytes) -> bytes:
    rest = fields.ljust(_HEADER[kind] - 8, b"\0") + data
    return _BEGIN + bytes((kind,)) + crc32(rest).to_bytes(4, "little") + rest


def read(payload: bytes) -> Datagram | Segment | None:
    """The packet of a payload; None: it is none, or damaged."""
    if payload[:3] != _BEGIN or len(payload) < 4 or payload[3] not in _HEADER or len(payload) < _HEADER[payload[3]]:
        return None
    kind, rest = payload[3], payload[8:]
    if crc32(rest) != int.from_bytes(payload[4:8], "little"):
        return None
    agent, from_port, to_port = _FIELDS.unpack_from(rest)
    data = rest[_HEADER[kind] - 8 :]
    if kind < 2:
        ip = rest[6:22] if kind else V4 + rest[6:10]
        return Datagram(agent, from_port, to_port, ip, data)
    return Segment(agent, from_port, to_port, *_SEGMENT.unpack_from(rest, 6), kind == 3, data)
