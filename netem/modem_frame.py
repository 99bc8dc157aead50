"""Payloads by which an agent has a modem of its own in the water: frames of it, and what it is told of them.

All three begin with 0x82 and `modem`, and a byte that says which it is:

| byte 6 | from, to | what follows |
|---|---|---|
| 0 | the agent, to its modem | nothing: the modem is switched on, and tells its news from now on. It is not sent. |
| 1 | the agent, to other modems | a frame |
| 2 | its modem, to the agent | news: MessagePack of a list of lists, times in ns of the run. Its sender is the agent. |

A frame:

| bytes | type | field |
|---|---|---|
| 7 .. 14 | i64 | when it has to begin [ns of the run], whoever's turn it is; -1: by medium access |
| 15 .. 18 | u32 | what its sender calls it |
| 19 | u8 | the address of its sender's modem |
| 20 | u8 | that of the modem that it is for; 0: all |
| 21 | u8 | protocol number |
| 22, 23 | u16 | n, the length of the head: what a modem says beside the payload, as in a preamble |
| 24 .. n+23 | | the head |
| n+24 .. | | the payload, which alone is on the air |

Numbers are little-endian. A damaged frame has no news, and is dropped: modems have checksums.
"""

from __future__ import annotations

from struct import Struct
from typing import NamedTuple

MARK = b"\x82modem"
SWITCH_ON, _FRAME, NEWS = MARK + b"\0", MARK + b"\1", MARK + b"\2"
_FIELDS = Struct("<qIBBBH")
_HEAD = len(_FRAME) + _FIELDS.size


class ModemFrame(NamedTuple):
    """A frame of a modem."""

    name: int  # what its sender calls it
    src: int  # addresses
    to: int
    what: int  # protocol number
    payload: bytes
    head: bytes = b""
    at_ns: int | None = None  # when it has to begin, of the run; None: by medium access

    def packed(self) -> bytes:
        """The payload of the agent."""
        at_ns = -1 if self.at_ns is None else max(0, self.at_ns)
        fields = _FIELDS.pack(at_ns, self.name & 0xFFFFFFFF, self.src, self.to, self.what, len(self.head))
        return b"".join((_FRAME, fields, self.head, self.payload))


def read_frame(payload: bytes) -> ModemFrame | None:
    """The frame of a payload; None: it holds none."""
    if not payload.startswith(_FRAME) or len(payload) < _HEAD:
        return None
    at_ns, name, src, to, what, size = _FIELDS.unpack_from(payload, len(_FRAME))
    head = payload[_HEAD : _HEAD + size]
    return ModemFrame(name, src, to, what, payload[_HEAD + size :], head, None if at_ns < 0 else at_ns)


def size_on_air(payload: bytes) -> int:
    """How many bytes of a payload are on the air: of a frame, those that it carries."""
    if not payload.startswith(_FRAME) or len(payload) < _HEAD:
        return len(payload)
    return max(0, len(payload) - _HEAD - int.from_bytes(payload[_HEAD - 2 : _HEAD], "little"))
