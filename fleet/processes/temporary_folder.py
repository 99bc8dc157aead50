"""One folder of this process for all temporary files; that of a process that was killed goes with the next one's.

Each folder has a file that its owner has locked. The kernel lifts the lock when the owner ends, however it ends.
"""

from __future__ import annotations

import atexit
import fcntl
import os
import shutil
import stat
import tempfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from fleet.errors import RunBroken
from fleet.processes.private_folder import FALLBACK

PREFIX = "uuv-fleet-tmp-"
_OWNER = "owner"  # the file that is locked
_MOST_PLACE = 60  # bytes; multiprocessing makes sockets in the folder, whose path may have 107


def temporary_folder() -> Path:
    """The folder of this process: mode 0700, removed at its end.

    Raises:
        RunBroken: it cannot be made.
    """
    return _folder_of(os.getpid())


@lru_cache(maxsize=1)
def _folder_of(pid: int) -> Path:
    place = tempfile.gettempdir()
    if len(os.fsencode(place)) > _MOST_PLACE:
        place = FALLBACK
    remove_deserted(place)
    try:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
        new = folder / f".{_OWNER}"
        # Nobody closes it. It gets its name when it is locked, so that no other process finds it before.
        lock = os.open(new, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        new.rename(folder / _OWNER)
    except OSError as error:
        raise RunBroken(f"cannot make a folder in {place}: {error.strerror}; set TMPDIR to another place") from None
    atexit.register(_remove, folder, pid)
    return folder


def _remove(folder: Path, pid: int) -> None:
    if os.getpid() == pid:  # and no process that was forked from it
        shutil.rmtree(folder, ignore_errors=True)


def remove_deserted(place: str) -> None:
    """Remove the folders of this user whose owners have ended. Links are not followed."""
    with suppress(OSError):
        folders = [entry.name for entry in os.scandir(place) if entry.name.startswith(PREFIX)]
        for name in folders:
            with suppress(OSError):
                _remove_if_deserted(Path(place) / name)


def _remove_if_deserted(folder: Path) -> None:
    """Raises OSError: it has an owner, belongs to somebody else, or is no folder."""
    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        found = os.fstat(opened)
        if found.st_uid != os.geteuid() or stat.S_IMODE(found.st_mode) != 0o700:
            return
        lock = os.open(_OWNER, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=opened)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
        finally:
            os.close(lock)
    finally:
        os.close(opened)
