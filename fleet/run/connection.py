"""A live run, seen from another terminal: find it by its connection file, and ask its console."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec

from fleet.errors import FleetError
from netem.errors import BusError
from netem.private_file import DamagedFile, parse_json
from netem.whole_file import read_file
from netem.wire.access import LEASE_MS, Credentials
from netem.wire.bus import Bus
from netem.wire.control import read_map, request
from netem.wire.keys import Keys

ASK_S = 5.0
MOST_BYTES = 100_000  # of a connection file, with certificates


class RemoteError(FleetError):
    """There is no such run, it does not answer, or it refuses."""

    status = 3


class ConnectionFile(msgspec.Struct):
    """The content of a connection file; one with any other content is not ours."""

    scenario: str
    pid: Annotated[int, msgspec.Meta(gt=0, lt=2**31)]  # of the console
    endpoint: str  # of the run's router, as zenoh writes it
    run: Annotated[str, msgspec.Meta(pattern=r"^[\w-]+$")]  # the run's id
    user: str
    password: str
    ca: str = ""  # PEM, as are the next two
    certificate: str = ""
    key: str = ""
    lease_ms: Annotated[int, msgspec.Meta(gt=0)] = LEASE_MS

    @classmethod
    def read(cls, path: Path) -> ConnectionFile | None:
        """What the file says; None: there is none of ours."""
        try:
            return parse_json(read_file(path, MOST_BYTES), cls)
        except (OSError, DamagedFile):
            return None


@dataclass(frozen=True, slots=True)
class LiveRun:
    """A live run: its directory and what its connection file says."""

    directory: Path
    scenario: str
    pid: int
    endpoint: str
    run: str
    credentials: Credentials

    def __repr__(self) -> str:
        return f"LiveRun({self.directory}, pid {self.pid})"


def live_runs(out: Path) -> list[LiveRun]:
    """The runs under a directory whose console lives, the newest first. Files that a killed run left are removed."""
    runs: list[tuple[float, LiveRun]] = []
    for path in out.glob("*/connection.json"):
        if path.parent.is_symlink():
            continue
        one = _read(path)
        if one is None:
            _remove_stale(path)
        else:
            runs.append((path.stat().st_mtime, one))
    return [one for _, one in sorted(runs, key=lambda pair: -pair[0])]


def find(run: Path | None, out: Path) -> LiveRun:
    """Find a live run.

    Args:
        run: its directory, also relative to `out`; None: the newest live run under `out`.

    Raises:
        RemoteError: there is none.
    """
    if run is None:
        runs = live_runs(out)
        if not runs:
            raise RemoteError(f"no live run under {out}; name one with --run DIR, or where runs are with --out DIR")
        return runs[0]
    directory = run if run.is_dir() else out / run
    path = directory / "connection.json"
    if not path.exists():
        raise RemoteError(f"{directory} is no live run: there is no connection file")
    one = _read(path)
    if one is None:
        raise RemoteError(f"the run in {directory} is over: its console is gone")
    return one


def is_live(run: LiveRun) -> bool:
    """Whether the console of a run lives and has not finished."""
    return _read(run.directory / "connection.json") is not None


def ask(run: LiveRun, op: str, **fields: Any) -> dict[str, Any]:
    """Ask the console of a run.

    Args:
        op: what `fleet.run.operator.Operator.handle` understands.

    Returns:
        Its answer.

    Raises:
        RemoteError: it does not answer in time, or refuses.
    """
    try:
        bus = Bus.connect(run.endpoint, run.credentials, timeout_ms=2000)
    except BusError as error:
        raise RemoteError(f"the run in {run.directory} cannot be reached: {error}") from None
    try:
        answer = bus.ask(f"{Keys(run.run).op}/{op}", request(op, **fields), timeout_s=ASK_S)
    finally:
        bus.close()
    if answer is None:
        raise RemoteError(f"the run in {run.directory} did not answer within {ASK_S:g} s; is it over?")
    values = read_map(answer)
    if "error" in values:
        raise RemoteError(f"refused: {values['error']}")
    return values


def _remove_stale(path: Path) -> None:
    """Remove the file of a console that was killed: it holds a password that is of no use any more."""
    values = ConnectionFile.read(path)
    import psutil  # only when a run was killed

    if values is not None and not psutil.pid_exists(values.pid):
        with contextlib.suppress(OSError):
            path.unlink()


def _read(path: Path) -> LiveRun | None:
    values = ConnectionFile.read(path)
    if values is None:
        return None
    try:
        os.kill(values.pid, 0)  # raises when there is no such process
    except OSError:
        return None
    credentials = Credentials.from_values(msgspec.structs.asdict(values))
    return LiveRun(path.parent, values.scenario, values.pid, values.endpoint, values.run, credentials)
