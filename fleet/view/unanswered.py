"""Closes connections to a port of this process that have not sent a request, where no code of ours accepts them.

The server of Foxglove's SDK accepts them itself, keeps them for ever, and has no hook for them. So we ask the kernel:
if nothing was sent back on a connection, it has not made its request.
"""

from __future__ import annotations

import os
import socket
import struct
import time
from contextlib import suppress

import psutil

from fleet.view.half_open_limit import FOR_S, most_half_open

EVERY_S = 0.5
_SEGMENTS_SENT = struct.Struct("=I"), 156  # tcpi_data_segs_out in Linux's struct tcp_info: those with data


class Unanswered:
    """The connections to one port that have not been answered yet."""

    def __init__(self, port: int, most: int | None = None, for_s: float = FOR_S) -> None:
        self._port, self._for_s = port, for_s
        self._most = most_half_open() if most is None else most
        self._since: dict[tuple[str, int], float] = {}  # by the address of the other end [s of time.monotonic]
        self._looked_s = 0.0

    def close_some(self, now_s: float | None = None) -> None:
        """Close connections that waited too long, and the oldest if there are too many; looks only every EVERY_S."""
        now = time.monotonic() if now_s is None else now_s
        if now < self._looked_s + EVERY_S or not hasattr(socket, "TCP_INFO"):  # which only Linux has
            return
        self._looked_s = now
        with suppress(psutil.Error, OSError):
            found = self._unanswered()
            self._since = {client: self._since.get(client, now) for client in found}
            waiting = sorted(self._since, key=self._since.__getitem__)
            late = [client for client in waiting if now - self._since[client] >= self._for_s]
            for client in {*late, *waiting[: max(0, len(waiting) - self._most)]}:
                _close(found[client], client)

    def _unanswered(self) -> dict[tuple[str, int], int]:
        """Their files by the address of the other end."""
        found = {}
        for one in psutil.Process().net_connections("tcp"):
            if one.laddr and one.laddr.port == self._port and one.raddr and one.status == psutil.CONN_ESTABLISHED:
                with suppress(OSError), socket.socket(fileno=os.dup(one.fd)) as connection:
                    kind, offset = _SEGMENTS_SENT
                    info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 256)
                    if len(info) >= offset + kind.size and not kind.unpack_from(info, offset)[0]:
                        found[one.raddr.ip, one.raddr.port] = one.fd
        return found


def _close(file: int, client: tuple[str, int]) -> None:
    """End a connection, unless its file is another one's by now."""
    with suppress(OSError), socket.socket(fileno=os.dup(file)) as connection:
        if connection.getpeername()[1] == client[1]:
            connection.shutdown(socket.SHUT_RDWR)
