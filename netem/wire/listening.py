"""Whether zenoh could listen at an address: seen before anything is started."""

from __future__ import annotations

import os
import socket
import stat
from contextlib import suppress
from pathlib import Path


def probe_address(host: str, port: int) -> None:
    """Bind a TCP socket there for a moment, as zenoh's listener will. Raises OSError if the port is taken or not for
    this user, or the address is not of this host.
    """
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind, protocol) as probe:
        # As zenoh's listener does: a port whose last connections are still winding down is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(address)


def socket_place(path: Path) -> str:
    """Why zenoh may not listen on a Unix socket at a path, or an empty text. It removes what is there before it
    listens, and `<path>.lock` when it ends. So only a socket of this user, in a folder that no other user may write,
    may be there, and an empty lock.
    """
    with suppress(FileNotFoundError):
        found, folder = os.lstat(path), os.stat(path.parent)
        ours = found.st_uid == folder.st_uid == os.geteuid() and not folder.st_mode & 0o022
        if not (ours and stat.S_ISSOCK(found.st_mode)):
            return f"{path} is there already, and is no socket of yours in a folder of yours; give a path that is free"
    with suppress(FileNotFoundError):
        lock = os.lstat(beside := f"{path}.lock")
        if lock.st_uid != os.geteuid() or not stat.S_ISREG(lock.st_mode) or lock.st_size:
            return f"{beside} is there already, and zenoh would remove it; give another path"
    return ""
