"""Connections of this process are closed without waiting.

Zenoh 1.10 opens them with SO_LINGER, 10 s. Closing a connection with unsent bytes then waits for them, on the one
thread that does all of zenoh's work here. Behind a cable that was pulled they are never taken. While zenoh waits, it
gives no signs of life on its other links either, and these end, too, when that takes longer than their lease. Without
SO_LINGER the kernel goes on sending in the background, as for every other program.

Two links behind a pulled cable kept that thread for 20 s, and a run that had to lose two agents lost all four in two of
five runs. A zenoh router that somebody else runs still waits so.
"""

from __future__ import annotations

import os
import socket
import stat
import struct
from contextlib import suppress
from pathlib import Path

_OFF = struct.pack("ii", 0, 0)


def never_linger() -> None:
    """Take the option from every TCP connection that is open now.

    All duplicates of a descriptor share it, so it can be set on a duplicate, which no other thread closes meanwhile.
    """
    for place in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            if not stat.S_ISSOCK(place.stat().st_mode):
                continue
            duplicate = os.dup(int(place.name))
            try:
                _set(duplicate)
            finally:
                os.close(duplicate)


def _set(descriptor: int) -> None:
    stream = socket.socket(fileno=descriptor)
    try:
        if stream.type == socket.SOCK_STREAM and stream.family in (socket.AF_INET, socket.AF_INET6):
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _OFF)
    finally:
        stream.detach()
