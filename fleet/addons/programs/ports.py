"""The ports of one agent, which all its processes share."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from agents.packets import V4
from fleet.addons.programs.known_ports import NAVIGATION_PORT

FIRST_FREE, LAST = 49152, 65535  # RFC 6335: the ports that nobody is registered for
_STREAM, _REUSES, _SHARES, _ONLY_V6 = 1, 2, 4, 8  # SO_REUSEADDR or SO_REUSEPORT; SO_REUSEPORT; IPV6_V6ONLY
_BOOKING = struct.Struct("<HBB16sH")
_NUMBER = struct.Struct("<H")


@dataclass(frozen=True)
class _Port:
    flags: int
    v6: bool
    ip: bytes
    port: int

    def excludes(self, other: _Port) -> bool:
        """Whether no second process can have the other one."""
        both = self.flags & other.flags
        if self.port != other.port or (self.flags ^ other.flags) & _STREAM:
            return False
        if both & _SHARES or (both & _REUSES and not both & _STREAM):
            return False
        if self.ip != other.ip and not (_is_any(self.ip) or _is_any(other.ip)):
            return False
        return self.v6 == other.v6 or not (self.flags | other.flags) & _ONLY_V6


class Ports:
    """Who has which port. What a single process may do with its own sockets, its library knows."""

    def __init__(self) -> None:
        self._of: dict[tuple[int, int], _Port] = {}  # by process and number of its socket
        self._next = {0: FIRST_FREE, _STREAM: FIRST_FREE}

    def book(self, process: int, data: bytes) -> bytes:
        """A socket is bound. The port as a message; 0: another process has it, or none is free.

        Several processes may hear where the vehicle is.
        """
        socket, flags, v6, ip, port = _BOOKING.unpack(data)
        wanted = _Port(flags, bool(v6), ip, port or self._free(flags & _STREAM))
        if (
            port
            and port != NAVIGATION_PORT
            and any(own != process and each.excludes(wanted) for (own, _), each in self._of.items())
        ):
            return _NUMBER.pack(0)
        self._of[process, socket] = wanted
        return _NUMBER.pack(wanted.port)

    def _free(self, kind: int) -> int:
        used = {each.port for each in self._of.values() if each.flags & _STREAM == kind}
        for _ in range(FIRST_FREE, LAST + 1):
            port = self._next[kind]
            self._next[kind] = FIRST_FREE if port == LAST else port + 1
            if port not in used:
                return port
        return 0

    def leave(self, process: int, data: bytes) -> None:
        """A socket is closed."""
        self._of.pop((process, _NUMBER.unpack(data)[0]), None)

    def on_process_ended(self, process: int) -> None:
        """A process has ended, or begins another executable."""
        for key in [key for key in self._of if key[0] == process]:
            del self._of[key]


def _is_any(ip: bytes) -> bool:
    return not any(ip) or ip == V4 + bytes(4)
