"""The Unix socket of a run's router, in a folder that only this user can enter.

A port on loopback is open to every user of the host. Another user could keep processes of the run out by holding
connections without logging in, or could take the port first and play the router.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from fleet.errors import RunBroken

PREFIX = "uuv-fleet-"
FALLBACK = "/tmp"
_ROUTER = "router"
_MOST_PATH = 107  # bytes that the system takes as the path of a socket
_PLAIN = re.compile(r"[\w./+-]+", re.ASCII)  # zenoh gives other characters in an endpoint a meaning


class PrivateFolder:
    """One run's folder, mode 0700, from its beginning to its end."""

    def __init__(self) -> None:
        """Make the folder, and remove the folders of runs that were killed.

        Raises:
            RunBroken: no folder can be made for it.
        """
        place = _place()
        _sweep(place)
        try:
            self.path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
        except OSError as error:
            raise RunBroken(
                f"cannot make a folder in {place}: {error.strerror}; set TMPDIR to another place"
            ) from error

    @property
    def endpoint(self) -> str:
        """The endpoint of the run's router, as zenoh writes it."""
        return f"unixsock-stream/{self.path / _ROUTER}"

    def close(self) -> None:
        """Remove it: from now on nothing can connect."""
        shutil.rmtree(self.path, ignore_errors=True)


def _place() -> Path:
    places = dict.fromkeys((tempfile.gettempdir(), FALLBACK))
    for place in places:
        if _PLAIN.fullmatch(place) and len(f"{place}/{PREFIX}12345678/{_ROUTER}.lock") <= _MOST_PATH:
            return Path(place)
    raise RunBroken(
        f"no place for the socket of the run: {' and '.join(places)} cannot be used, since the path is too long or has "
        "other characters than letters, digits and . / + - _; set TMPDIR to another place"
    )


def _sweep(place: Path) -> None:
    """Remove the folders of runs that were killed."""
    for folder in place.glob(f"{PREFIX}*"):
        with suppress(OSError):
            found = folder.lstat()
            if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and _deserted(folder / _ROUTER):
                shutil.rmtree(folder, ignore_errors=True)


def _deserted(path: Path) -> bool:
    """Whether there is a socket whose router is gone: zenoh locks a file beside it before it makes the socket."""
    if not path.is_socket():
        return False
    with path.with_name(f"{path.name}.lock").open("rb") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True
