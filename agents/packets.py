"""Packets between the nodes of programs: what an agent's payload holds, and how long it is.

A payload is as long as the packet that it stands for: the bytes of the program, and a header of IP with UDP
(28 bytes, 48 of IPv6) or with TCP (40 and 60). In its room the header holds

| bytes | type | field |
|---|---|---|
| 0 .. 2 | u8 | 0x81, 1, `p`: a payload of the kind `p`, see agents/message.py |
| 3 | u8 | what follows: 0 a datagram of IPv4, 1 of IPv6, 2 a segment over IPv4, 3 over IPv6 |
| 4 .. 7 | u32 | CRC-32 (zlib) of all the rest, since the network may flip bits, and UDP and TCP have checksums, too |
| 8, 9 | u16 | the agent that it is for; 0: all |
| 10 .. 13 | u16 | its ports: from, to |
| 14 .. | | the address that it is for, 4 or 16 bytes; u16 the datagram of a fragment, u8 its place, u8 how many |
| 14 .. | | of a segment: its fields |

What does not fit into the MTU travels in fragments, as IP does it. (Of IP, only the first fragment has the ports, and
the others are 8 bytes shorter than here.)

Numbers are little-endian. The address of the sender is that of its node: 10.0.0.NUMBER, or fd00::NUMBER.
"""

from __future__ import annotations

import struct
from typing import NamedTuple
from zlib import crc32

EVERYBODY = 0
BEGIN = b"\x81\x01p"  # of every packet: a message of the kind `p`
_FIELDS = struct.Struct("<HHH")
MTU = 1500
MOST_PARTIAL = 64  # datagrams of which fragments are missing; the oldest is given up, as after 30 s in Linux
_FRAGMENT = struct.Struct("<HBB")
_HEADER = {0: 28, 1: 48, 2: 40, 3: 60}
V4 = bytes(10) + b"\xff\xff"


class Datagram(NamedTuple):
    """A datagram on its way."""

    agent: int  # it is for; EVERYBODY: all
    from_port: int
    to_port: int
    to_ip: bytes  # 16 bytes; IPv4 as ::ffff:a.b.c.d
    data: bytes
    number: int = 0  # of the datagram that it is a fragment of
    place: int = 0
    places: int = 1

    def packed(self) -> bytes:
        """The payload."""
        v6 = self.to_ip[:12] != V4
        fields = _FIELDS.pack(self.agent, self.from_port, self.to_port) + (self.to_ip if v6 else self.to_ip[12:])
        return _whole(1 if v6 else 0, fields + _FRAGMENT.pack(self.number, self.place, self.places), self.data)

    def fragments(self, number: int) -> list[Datagram]:
        """The packets that it travels in. `number`: of the datagram, among those of its sender."""
        room = MTU - _HEADER[1 if self.to_ip[:12] != V4 else 0]
        if len(self.data) <= room:
            return [self]
        parts = [self.data[at : at + room] for at in range(0, len(self.data), room)]
        return [self._replace(data=part, number=number, place=k, places=len(parts)) for k, part in enumerate(parts)]


class DatagramAssembly:
    """Fragments that have come, until their datagrams are whole."""

    def __init__(self) -> None:
        self._parts: dict[tuple[int, Datagram], dict[int, Datagram]] = {}

    def whole(self, src: int, packet: Datagram) -> Datagram | None:
        """The datagram that a packet completes; None: others are missing. `src`: the agent that has sent it."""
        if packet.places == 1:
            return packet
        key = src, packet._replace(place=0, data=b"")  # ports, too: each port of a law counts by itself
        parts = self._parts.setdefault(key, {})
        parts[packet.place] = packet
        if len(parts) == packet.places:
            del self._parts[key]
            data = b"".join(parts[k].data for k in sorted(parts))
            return packet._replace(data=data, place=0, places=1)
        if len(self._parts) > MOST_PARTIAL:
            del self._parts[next(iter(self._parts))]
        return None


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
    return BEGIN + bytes((kind,)) + crc32(rest).to_bytes(4, "little") + rest


def read(payload: bytes) -> Datagram | Segment | None:
    """The packet of a payload; None: it is none, or damaged."""
    if payload[:3] != BEGIN or len(payload) < 4 or payload[3] not in _HEADER or len(payload) < _HEADER[payload[3]]:
        return None
    kind, rest = payload[3], payload[8:]
    if crc32(rest) != int.from_bytes(payload[4:8], "little"):
        return None
    agent, from_port, to_port = _FIELDS.unpack_from(rest)
    data = rest[_HEADER[kind] - 8 :]
    if kind < 2:
        ip, at = (rest[6:22], 22) if kind else (V4 + rest[6:10], 10)
        return Datagram(agent, from_port, to_port, ip, data, *_FRAGMENT.unpack_from(rest, at))
    kind_of, connection, sequence, acknowledged, window = _SEGMENT.unpack_from(rest, 6)
    return Segment(agent, from_port, to_port, kind_of, connection, sequence, acknowledged, window, kind == 3, data)
