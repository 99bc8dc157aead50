"""Folders for this user only, below TMPDIR. One whose owner was killed is removed when the next one is made.

The owner holds a lock (flock) on a file in the folder. The system gives the lock back when the owner ends, however it
ends: a folder without a holder is a leftover.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import stat
import tempfile
from contextlib import suppress
from pathlib import Path
from time import CLOCK_REALTIME, clock_gettime
from types import TracebackType

PREFIX = "uuv-fleet-"
LOCK = "owner.lock"  # the file in the folder that is locked
UNFINISHED_S = 60.0  # after which a folder without a lock was left by somebody killed while making or removing it
SHORT = "/tmp"  # a place for those who need a short path


class PrivateFolder:
    """A folder of mode 0700, from its making to `close`, or to the end of the process that made it."""

    def __init__(self, kind: str = "", place: Path | None = None) -> None:
        """Remove what killed processes left, and make the folder. `kind`: its purpose, as part of its name, which is
        then `uuv-fleet-<kind>-...`. `place`: the folder to make it in; None: TMPDIR. Raises OSError: it cannot be made
        there."""
        sweep()
        prefix = f"{PREFIX}{kind}-" if kind else PREFIX
        self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
        # The lock is held before the folder has its name: no other process finds it free.
        new = self.path / f"{LOCK}.new"
        self.lock = os.open(new, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            new.rename(self.path / LOCK)
        except OSError:  # a file system without locks: the folder has none, and no process takes it for a leftover
            new.unlink(missing_ok=True)

    def close(self) -> None:
        """Remove the folder with its content."""
        _remove(self.path)
        if self.lock >= 0:
            os.close(self.lock)
            self.lock = -1

    def __enter__(self) -> Path:
        return self.path

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def runtime_place() -> Path | None:
    """The folder that the system gives this user until logout; None if there is none, or if another user owns it."""
    given = os.environ.get("XDG_RUNTIME_DIR", "")
    usable = Path(given).is_absolute() and Path(given).is_dir() and os.access(given, os.W_OK | os.X_OK)
    return Path(given) if usable else None


def sweep() -> None:
    """Remove the private folders of this user whose owners have ended. Links are not followed."""
    for place in dict.fromkeys((tempfile.gettempdir(), SHORT, str(runtime_place() or SHORT))):
        with suppress(OSError), os.scandir(place) as entries:
            found = [entry.path for entry in entries if entry.name.startswith(PREFIX)]
            for path in found:
                with suppress(OSError):
                    _remove_deserted(path)


def _remove(path: str | Path) -> None:
    """Remove a folder, its lock last: who is killed in the middle of this leaves a folder that can be swept."""
    with suppress(OSError), os.scandir(path) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            elif entry.name != LOCK:
                with suppress(OSError):
                    os.unlink(entry.path)
    shutil.rmtree(path, ignore_errors=True)


def _remove_unfinished(path: str, folder: int) -> None:
    """Remove a folder that never had its lock, or has it no more, if it is old and holds nothing."""
    if (
        set(os.listdir(folder)) <= {f"{LOCK}.new"}
        and os.fstat(folder).st_mtime < clock_gettime(CLOCK_REALTIME) - UNFINISHED_S
    ):
        _remove(path)


def _remove_deserted(path: str) -> None:
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        if os.fstat(folder).st_uid != os.geteuid():
            return
        try:
            lock = os.open(LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
        except FileNotFoundError:
            _remove_unfinished(path, folder)
            return
        try:
            if stat.S_ISREG(os.fstat(lock).st_mode):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _remove(path)
        finally:
            os.close(lock)
    finally:
        os.close(folder)
