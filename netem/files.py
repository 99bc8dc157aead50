"""Files with secrets, which may be damaged or readable by others: read only if private, checked as a whole."""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path
from typing import IO, TypeVar

import msgspec

from netem.errors import NetemError


def open_file(path: Path) -> IO[bytes]:
    """A regular file to read. A pipe would be waited for, and some devices never end. Raises OSError: it is none, or
    cannot be opened."""
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC), "rb")
    mode = os.fstat(file.fileno()).st_mode
    if stat.S_ISREG(mode):
        return file
    file.close()
    kind = "a pipe" if stat.S_ISFIFO(mode) else "a device" if stat.S_ISCHR(mode) or stat.S_ISBLK(mode) else "something"
    raise OSError(errno.EINVAL, f"it is {kind}, not a file")


def read_file(path: Path, most: int) -> bytes:
    """The content of a regular file, up to a number of bytes. Raises OSError: it is none, it is larger, or it cannot be
    read."""
    with open_file(path) as file:
        return read_bounded(file, most)


def read_bounded(file: IO[bytes], most: int) -> bytes:
    """The rest of an open file. Raises OSError: it is longer than `most` bytes."""
    data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most / 1e6:g} MB")
    return data


T = TypeVar("T")


class ExposedFile(NetemError):
    """A file that holds a secret and that others can read."""


class DamagedFile(NetemError):
    """A file that does not say what it should; the text says where, what was expected and what is there."""


def read_private(path: Path, most: int) -> bytes:
    """The content of a regular file that only its owner can read, up to a number of bytes. Raises OSError: it is no
    regular file, it is larger, or it cannot be read; ExposedFile: others can read it."""
    with open_file(path) as file:
        mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
        data = read_bounded(file, most)
    if mode & 0o077:
        raise ExposedFile(
            f"{path} holds a secret and can be read by others (mode {mode:04o}, expected 0600): chmod 600 {path}"
        )
    return data


def read_json(path: Path, kind: type[T], most: int) -> T:
    """A file of JSON, up to a number of bytes, as a value of a type that msgspec can check. Raises OSError: it is no
    regular file, it is larger, or it cannot be read; DamagedFile: as `parse_json`."""
    return parse_json(read_file(path, most), kind)


def parse_json(data: bytes, kind: type[T]) -> T:
    """JSON as a value of a type that msgspec can check; fields that it does not have are ignored. Raises DamagedFile:
    it is not JSON, or a field is missing, has another type or is out of its range."""
    try:
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise DamagedFile(_words(str(error))) from None
    except (ValueError, RecursionError) as error:
        raise DamagedFile(f"not JSON ({error!s:.100})") from None


def _words(text: str) -> str:
    if missing := re.fullmatch(r"Object missing required field `(\w+)`.*", text):
        return f"it has no {missing[1]!r}"
    what, _, where = text.partition(" - at `$")
    for theirs, ours in (("Expected `object`", "expected a map"), ("Expected `array`", "expected a list")):
        what = what.replace(theirs, ours)
    what = what.replace("`object`", "map").replace("`array`", "list").replace("`", "")
    place = where.removesuffix("`").removeprefix(".")
    return f"{place}: {what[0].lower()}{what[1:]}" if place else f"{what[0].lower()}{what[1:]}"
