"""From another terminal: find a live run by its connection file, and ask its console."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleet.errors import FleetError
from netem.access import Credentials
from netem.bus import Bus
from netem.errors import BusError
from netem.keys import Keys
from netem.shell import read_map, request

ASK_S = 5.0


class RemoteError(FleetError):
    """There is no such run, it does not answer, or it refused."""


@dataclass(frozen=True, slots=True)
class Found:
    """A live run: its directory and what its connection file says."""

    directory: Path
    scenario: str
    pid: int
    endpoint: str
    run: str
    credentials: Credentials

    def __repr__(self) -> str:
        return f"Found({self.directory}, pid {self.pid})"


def live_runs(out: Path) -> list[Found]:
    """The runs under a directory whose console lives, the newest first."""
    found: list[tuple[float, Found]] = []
    for path in out.glob("*/connection.json"):
        if path.parent.is_symlink():
            continue
        one = _read(path)
        if one is None:
            _forget(path)
        else:
            found.append((path.stat().st_mtime, one))
    return [one for _, one in sorted(found, key=lambda pair: -pair[0])]


def find(run: Path | None, out: Path) -> Found:
    """The run that is meant: a run directory, or the newest live one under `out`.

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


def is_live(found: Found) -> bool:
    """Whether the console of a run lives and has not finished."""
    return _read(found.directory / "connection.json") is not None


def ask(found: Found, op: str, **fields: Any) -> dict[str, Any]:
    """The console's answer.

    Raises:
        RemoteError: it does not answer in time, or refuses.
    """
    try:
        bus = Bus.connect(found.endpoint, found.credentials, timeout_ms=2000)
    except BusError as error:
        raise RemoteError(f"the run in {found.directory} cannot be reached: {error}") from None
    try:
        answer = bus.ask(f"{Keys(found.run).op}/{op}", request(op, **fields), timeout_s=ASK_S)
    finally:
        bus.close()
    if answer is None:
        raise RemoteError(f"the run in {found.directory} did not answer within {ASK_S:g} s; is it over?")
    values = read_map(answer)
    if "error" in values:
        raise RemoteError(f"refused: {values['error']}")
    return values


def _forget(path: Path) -> None:
    """Remove what a console that was killed has left: it holds a password, and nobody answers any more."""
    try:
        pid = int(json.loads(path.read_text("utf-8"))["pid"])
        if not Path(f"/proc/{pid}").exists():
            path.unlink()
    except (OSError, ValueError, KeyError, TypeError):
        return  # not one of ours


def _read(path: Path) -> Found | None:
    try:
        values = json.loads(path.read_text("utf-8"))
        one = Found(
            path.parent,
            values["scenario"],
            int(values["pid"]),
            values["endpoint"],
            values["run"],
            Credentials.from_values(values),
        )
        os.kill(one.pid, 0)  # raises when there is no such process
    except PermissionError:
        return None
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return one
