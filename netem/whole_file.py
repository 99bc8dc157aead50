"""Files that are there as a whole or not at all: what holds keys and passwords, and what others read meanwhile."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex


def write_whole(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Make a file, or replace it, as `whole_file` does. It is on the disk when this returns: after a loss of power
    there is the old file or the new one. Raises OSError: it cannot be written; nothing is left behind, and what was
    there before stays."""
    with whole_file(path, mode) as part, part.open("wb") as file:
        file.write(data)
        file.flush()
        if part != path:  # not a device or a pipe
            os.fsync(file.fileno())
    if path.is_file():
        sync_folder(Path(os.path.realpath(path)).parent)


def sync_folder(folder: Path) -> None:
    """Have the names of a folder's files on the disk. Raises OSError."""
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


@contextmanager
def whole_file(path: Path, mode: int = 0o666) -> Iterator[Path]:
    """Where to write what shall become `path` at the end; an error or Ctrl-C on the way leaves nothing.

    A link of the user's own stays one: what it leads to is replaced. A link of somebody else is replaced
    itself. A device or a pipe is written to at once.

    Args:
        path: the file. If the part is gone at the end, nothing becomes of it.
        mode: permissions of a new file, less those that the umask takes.

    Raises:
        OSError: there is no room or no right for it.
    """
    if path.exists() and not path.is_file():  # a device or a pipe, which cannot replace another file
        yield path
        return
    if path.is_symlink() and path.lstat().st_uid in (0, os.geteuid()):
        path = Path(os.path.realpath(path))
    part = part_of(path)
    try:
        os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode))
        yield part
        if part.exists():
            part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def part_of(path: Path) -> Path:
    """A place beside `path` for what shall take its place. Its name cannot be guessed, so others who may write into the
    folder cannot lead it elsewhere."""
    return path.with_name(f".{path.stem[:100]}-{token_hex(8)}{path.suffix}")  # some writers go by the suffix
