"""The runs below a directory: which there are, what they came to, how large they are, and which may go."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct, field

from fleet.errors import FleetError
from fleet.execution.directory import LATEST, SCENARIO, is_in_use, link_latest, no_place
from fleet.logs.run_name import RUN_NAME, begin_time
from fleet.result.file import ResultError, read_result
from fleet.result.result import Status

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
            if is_in_use(run.path):
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
        began = begin_time(entry.name)
        if began is None or not entry.is_dir(follow_symlinks=False):
            continue
        path = Path(entry.path)
        if os.path.isfile(path / SCENARIO) and os.path.isdir(path / "log"):
            yield path, began


def _read(path: Path, began: datetime) -> PastRun:
    name = RUN_NAME.fullmatch(path.name)
    assert name is not None  # only directories with such a name get here
    verdict, sim_s = BROKE, None
    if is_in_use(path):
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
