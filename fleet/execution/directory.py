"""The directory of a run: its log, its result and the logs of its processes. A `latest` link stands next to it.

While the run goes on, its console holds a lock on the file with the scenario. The system takes the lock away when the
process ends, however it ends, so it says which runs live.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import secrets
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from fleet.errors import FleetError
from fleet.logs.run_name import STAMP
from fleet.result.file import RESULT
from fleet.scenario.trust import remember
from netem.files import open_file
from netem.whole_file import write_whole

LATEST = "latest"
LOG, SCENARIO, CONNECTION, OBSERVE = "run.mcap", "scenario.yaml", "connection.json", "observe.json"


def no_place(doing: str, error: OSError) -> FleetError:
    """The error of a run directory that cannot be made or written; its status is 3 where any other place is as full."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    hint = "make room, or choose" if full else "choose"
    return FleetError(f"{doing}: {error.strerror}; {hint} another place with --out DIR", status=3 if full else 2)


class RunDirectory:
    """`<out>/<scenario>-<seed>-<UTC time>/` with scenario.yaml, run.mcap, result.json and log/<process>.log."""

    def __init__(self, out: Path, scenario: str, seed: int) -> None:
        """Make the directory in `out`, which is made as well. Raises FleetError: none can be made there."""
        stamp = time.strftime(STAMP, time.gmtime())
        base = f"{scenario}-{seed}-{stamp}"
        try:
            out.mkdir(parents=True, exist_ok=True)
            self.path = _make_unique(out, base)
            (self.path / "log").mkdir()
        except OSError as error:
            raise no_place(f"cannot make a run directory in {out}", error) from error
        link_latest(out, self.path.name)
        self._scenario: IO[bytes] | None = None  # open while the run goes on
        self.locked = False  # whether others can see that it does; not every file system has locks

    @property
    def log(self) -> Path:
        return self.path / LOG

    @property
    def connection(self) -> Path:
        """How to reach the run; mode 0600; it exists only while the run lives."""
        return self.path / CONNECTION

    @property
    def observe(self) -> Path:
        """Where and as whom to subscribe to a published run; mode 0600; it exists only while the run lives."""
        return self.path / OBSERVE

    def join(self, i: int) -> Path:
        """The join file of external agent i; mode 0600; it exists only while the run lives."""
        return self.path / f"join-{i}.json"

    def join_folder(self, i: int) -> Path:
        """The join folder of external agent i, for joining with a certificate alone; as `join`, mode 0700."""
        return self.path / f"join-{i}"

    def process_log(self, role: str) -> Path:
        return self.path / "log" / f"{role}.log"

    def write_scenario(self, text: str) -> None:
        """Write the merged scenario, and lock it until `close`. Raises FleetError: there is no room."""
        path, unlocked = self.path / SCENARIO, self.path / f".{SCENARIO}"
        try:
            unlocked.write_text(text, "utf-8")
            self._scenario = unlocked.open("ab")
            with suppress(OSError):
                fcntl.flock(self._scenario, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self.locked = True
            remember(text)
            unlocked.rename(path)  # only now: who finds it without a lock takes the run for a dead one
        except OSError as error:
            raise no_place(f"cannot write {path}", error) from error

    def close(self) -> None:
        """Release the lock: the run is over."""
        if self._scenario is not None:
            self._scenario.close()

    def remove_result(self) -> None:
        """Remove the result: half of one is worse than none."""
        (self.path / RESULT).unlink(missing_ok=True)

    def write_connection(self, values: dict[str, Any]) -> None:
        """Write the connection file. Raises FleetError: there is no room."""
        try:
            write_whole(self.connection, json.dumps(values).encode())
        except OSError as error:
            raise no_place(f"cannot write {self.connection}", error) from error


def link_latest(out: Path, name: str) -> None:
    """Let the link `latest` lead to a run in the same directory, if that is possible: it is a convenience only."""
    temporary = out / f".{LATEST}-{secrets.token_hex(4)}"
    try:
        temporary.symlink_to(name)
        os.replace(temporary, out / LATEST)
    except OSError:
        # The file system has no links, or `latest` is a directory.
        temporary.unlink(missing_ok=True)


def is_in_use(directory: Path) -> bool:
    """Whether a run goes on in a directory; one that was killed is over at once, whoever has its number now. Where that
    cannot be seen (a file system without locks), one without a result may go on.
    """
    # The console holds this lock. A number of its process would not do: after a `kill -9` another process may have it.
    try:
        with open_file(directory / SCENARIO) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as error:
        there_is_none = error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ELOOP)
        return not there_is_none and not os.path.exists(directory / RESULT)
    return False


def remove_secrets(directory: Path) -> None:
    """Remove what a killed run left: files with passwords that are of no use any more."""
    with suppress(OSError):
        for path in (directory / CONNECTION, directory / OBSERVE, *directory.glob("join-*.json")):
            path.unlink(missing_ok=True)
        for folder in directory.glob("join-*"):
            shutil.rmtree(folder, ignore_errors=True)


def _make_unique(out: Path, base: str) -> Path:
    path, number = out / base, 1
    while True:
        with suppress(FileExistsError):
            path.mkdir()
            return path
        number += 1
        path = out / f"{base}-{number}"
