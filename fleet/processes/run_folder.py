"""Private folders with a short path, because they hold sockets: that of a run's router, and multiprocessing's.

A port on loopback is open to every user of the host. Another user could keep processes of the run out by holding
connections without logging in, or could take the port first and play the router.

A stranger cannot reach a socket in a folder of mode 0700. Measured on a loopback port: 300 connections of another user
kept a restarted agent out, because zenoh limits the number of connections without login. The socket is no slower:
53,000 round trips/s of 200 bytes against 49,000 over TCP. The run directory is not the place: its path may be longer
than the 107 bytes of a socket's, and its file system may have no sockets. `--port` adds a port for agents that cannot
use it.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.forkserver
import multiprocessing.process
import os
import re
import tempfile
from multiprocessing.util import Finalize
from pathlib import Path

from fleet.errors import RunBroken
from netem.private_folder import PREFIX, SHORT, PrivateFolder

_ROUTER = "router"
_MOST_PATH = 107  # bytes that the system takes as the path of a socket
_LONGEST_NAME = f"{PREFIX}processes-12345678/listener-12345678"
_PLAIN = re.compile(r"[\w./+-]+", re.ASCII)  # zenoh gives other characters in an endpoint a meaning


class RunFolder(PrivateFolder):
    """The folder of one run, from its beginning to its end."""

    def __init__(self) -> None:
        """Make the folder. Raises RunBroken: no folder can be made for it."""
        place = _place()
        try:
            super().__init__(place=place)
        except OSError as error:
            raise RunBroken(
                f"cannot make a folder in {place}: {error.strerror}; set TMPDIR to another place"
            ) from error

    @property
    def endpoint(self) -> str:
        return f"unixsock-stream/{self.path / _ROUTER}"


def own_folder_for_multiprocessing() -> None:
    """Let multiprocessing put its sockets into a private folder of this process: its own (`pymp-...`) would stay after
    a SIGKILL, and its socket cannot be made where TMPDIR is long.
    """
    settings = multiprocessing.process.current_process()._config  # type: ignore[attr-defined]
    if settings.get("tempdir") is None:
        try:
            folder = PrivateFolder("processes", _place())
        except (OSError, RunBroken):  # multiprocessing then makes its own, and says why if that fails
            return
        settings["tempdir"] = str(folder.path)
        close_at_end(folder)


def close_at_end(folder: PrivateFolder) -> None:
    """Close a folder at the end of this process, and of no process that is forked from it."""
    Finalize(None, _close, args=(folder, os.getpid()), exitpriority=-100)  # behind all that uses it


def _close(folder: PrivateFolder, owner: int) -> None:
    if os.getpid() == owner:
        folder.close()


def _place() -> Path:
    places = dict.fromkeys((tempfile.gettempdir(), SHORT))
    for place in places:
        if _PLAIN.fullmatch(place) and len(f"{place}/{_LONGEST_NAME}") <= _MOST_PATH:
            return Path(place)
    raise RunBroken(
        f"there is no folder for the run's socket: {' and '.join(places)} cannot be used. The path is too long, or "
        f"has characters other than letters, digits and . / + - _; set TMPDIR to another folder"
    )
