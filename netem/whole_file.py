"""Files that are there as a whole or not at all: what holds keys and passwords, and what others read meanwhile."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from secrets import token_hex
from typing import IO


def write_whole(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Make a file, or replace it: no reader sees a part of it, and it never has another mode.

    Raises:
        OSError: it cannot be written; nothing is left behind, and what was there before stays.
    """
    temporary = path.with_name(f".{path.name}-{token_hex(4)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def open_file(path: Path) -> IO[bytes]:
    """A regular file to read. A pipe would be waited for, and some devices never end.

    Raises:
        OSError: it is none, or cannot be opened.
    """
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC), "rb")
    mode = os.fstat(file.fileno()).st_mode
    if stat.S_ISREG(mode):
        return file
    file.close()
    kind = "a pipe" if stat.S_ISFIFO(mode) else "a device" if stat.S_ISCHR(mode) or stat.S_ISBLK(mode) else "something"
    raise OSError(errno.EINVAL, f"it is {kind}, not a file")


def read_file(path: Path, most: int) -> bytes:
    """The content of a regular file, up to a number of bytes.

    Raises:
        OSError: it is none, it is larger, or it cannot be read.
    """
    with open_file(path) as file:
        return read_bounded(file, most)


def read_bounded(file: IO[bytes], most: int) -> bytes:
    """The rest of an open file. Raises OSError: more than so many bytes."""
    data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most / 1e6:g} MB")
    return data
