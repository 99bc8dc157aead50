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
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Annotated, Any

from msgspec import Meta, Struct, field

from fleet.errors import FleetError
from fleet.logs.topic_names import RUN_NAME, STAMP, begun_at
from fleet.result.file import RESULT, ResultError, read_result
from fleet.result.result import Status
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


def in_use(directory: Path) -> bool:
    """Whether a run goes on in a directory; one that was killed is over at once, whoever has its number now. Where that
    cannot be seen (a file system without locks), one without a result may go on.
    """
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


# --- past runs: those below a directory: which there are, what they came to, how large they are, and which may go


PASS, FAIL, BROKE, STOPPED, LIVE = VERDICTS = ("pass", "FAIL", "broke", "stopped", "live")
FINISHED = VERDICTS[:-1]
_OF_STATUS = {
    Status.PASS: PASS,
    Status.CHECK_FAILED: FAIL,
    Status.BROKEN: BROKE,
    Status.INTERRUPTED: STOPPED,
    Status.HUNG_UP: STOPPED,
}


class PastRun(Struct, frozen=True):
    """One run directory, of a run that goes on or is over."""

    name: str = field(name="run")
    path: Path = field(name="directory")
    scenario: str
    verdict: Annotated[str, Meta(description="pass, FAIL, broke (also: left no result), stopped or live.")]
    sim_s: Annotated[float | None, Meta(description="Simulated time that was reached; null: there is no result.")]
    size: Annotated[int, Meta(description="Size of all files in the directory [bytes].")] = field(name="size_bytes")
    began: Annotated[datetime, Meta(description="UTC, ISO 8601.")]
    age_s: float


def past_runs(out: Path) -> list[PastRun]:
    """The runs below a directory, the newest first. Links, and directories that are not ours, are left out. Raises
    FleetError if the directory cannot be read.
    """
    found = [_read(path, began) for path, began in _ours(out)]
    return sorted(found, key=lambda run: (run.began, run.name), reverse=True)


def newest_run(out: Path) -> Path | None:
    """The directory of the newest run: the target of `latest`, or else the run that began last. Raises FleetError if
    the directory cannot be read.
    """
    with suppress(OSError):
        path = out / (out / LATEST).readlink()
        if path.is_dir():
            return path
    return _began_last(out)


def to_prune(runs: Sequence[PastRun], *, keep: int, older_than_s: float, verdicts: Collection[str]) -> list[PastRun]:
    """The runs to remove of `runs`, the newest first: of these verdicts, and older than `older_than_s` [s]. The `keep`
    newest runs and live ones stay in any case.
    """
    over = [run for run in runs if run.verdict != LIVE]
    return [run for run in over[keep:] if run.verdict in verdicts and run.age_s >= older_than_s]


def remove(out: Path, runs: Sequence[PastRun]) -> Iterator[PastRun]:
    """Remove run directories with their content, and yield each; one that is in use again stays. Targets of links stay,
    and `latest` is mended. Raises FleetError if a directory cannot be removed.
    """
    try:
        for run in runs:
            if in_use(run.path):
                continue
            try:
                shutil.rmtree(run.path)
            except OSError as error:
                raise FleetError(f"cannot remove {run.path}: {error.strerror}", status=3) from None
            yield run
    finally:
        _mend_latest(out)


def _mend_latest(out: Path) -> None:
    link = out / LATEST
    if not link.is_symlink() or link.exists():
        return
    newest = _began_last(out)
    if newest is None:
        link.unlink(missing_ok=True)
    else:
        link_latest(out, newest.name)


def _began_last(out: Path) -> Path | None:
    return max(_ours(out), key=lambda pair: (pair[1], pair[0]), default=(None,))[0]


def _ours(out: Path) -> Iterator[tuple[Path, datetime]]:
    """The run directories below a directory, and when they began. Ours has a name that `fleet run` gives, a scenario
    and a folder of logs; so one that a user renamed is never removed.
    """
    try:
        entries = list(os.scandir(out))
    except FileNotFoundError:
        return
    except OSError as error:
        raise no_place(f"cannot read {out}", error) from None
    for entry in entries:
        began = begun_at(entry.name)
        if began is None or not entry.is_dir(follow_symlinks=False):
            continue
        path = Path(entry.path)
        if os.path.isfile(path / SCENARIO) and os.path.isdir(path / "log"):
            yield path, began


def _read(path: Path, began: datetime) -> PastRun:
    name = RUN_NAME.fullmatch(path.name)
    assert name is not None  # it is one of ours
    verdict, sim_s = BROKE, None
    if in_use(path):
        verdict = LIVE
    else:
        with suppress(OSError, ResultError):
            result = read_result(path)
            verdict, sim_s = _OF_STATUS[result.status], result.sim_s
    now = datetime.now(UTC)  # noqa: TID251 (the ages of files, by the clock that gave them their names)
    age_s = (now - began).total_seconds()
    return PastRun(path.name, path, name["scenario"], verdict, sim_s, _size(path), began, age_s)


def _size(path: Path) -> int:
    total = 0
    for folder, _, files in os.walk(path):
        for file in files:
            with suppress(OSError):
                total += os.lstat(os.path.join(folder, file)).st_size
    return total
