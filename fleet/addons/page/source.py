"""The source for a viewer: a live run that is published, or a log."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from fleet.errors import FleetError
from fleet.execution.connection import LiveRun, RemoteError, choose, find, near_ones, published_runs, runs_named
from fleet.execution.directory import OBSERVE, SCENARIO, is_in_use
from fleet.execution.past_runs import newest_run
from fleet.execution.registry import registered_runs
from fleet.mcap.reader import log_path
from fleet.replay.observed import Observed, read_observed
from netem.files import DamagedFile


@dataclass(frozen=True, slots=True)
class LiveSource:
    """A live run: who may read its journal, and who may ask its console."""

    directory: Path  # of the run, or of its observe.json
    observed: Observed  # the address of its journal, and the login to subscribe with
    run: LiveRun | None  # None: there are only the observer's credentials, so it can only be watched
    awaited: bool = False  # it is about to begin, and its console will answer

    def open_control(self) -> LiveRun:
        """The run, to be disturbed. Raises FleetError: it can only be watched."""
        if self.run is None:
            raise FleetError(
                f"only what an observer needs is at hand ({self.directory}): the run can be watched, with --read-only"
            )
        return self.run


@dataclass(frozen=True, slots=True)
class LogSource:
    """A log, whole or cut."""

    path: Path


def find_source(name: str | None, runs: Path) -> LiveSource | LogSource:
    """What is meant.

    Args:
        name: a live run (its name or the beginning of it, its scenario, its directory), an observe.json, a log, or the
            directory of a run that is over. None: of the live runs below `runs` or the working directory the one that
            began last; if none lives there, the newest run below `runs`.
        runs: the folder of runs.

    Raises:
        FleetError: there is none, or the run is not published.
        RemoteError: a name means several live runs.
        RegistryError: it is not known which runs there are.
    """
    if name is None:
        return _newest(runs)
    path = Path(name)
    if path.suffix == ".json" and os.path.isfile(path):
        return _live(path)
    if os.path.exists(path / OBSERVE) and is_in_use(path):
        return _live(path.resolve() / OBSERVE)
    if os.path.exists(path / SCENARIO) and is_in_use(path):
        raise _not_published(path)
    if os.path.isfile(path) or os.path.exists(log_path(path)):
        return LogSource(log_path(path))
    try:
        return _live(choose(name, OBSERVE) / OBSERVE)
    except RemoteError as error:
        if error.status == 2:  # several
            raise
        if living := runs_named(name, registered_runs()):
            raise _not_published(max(living, key=_began)) from None
        if os.path.exists(path):  # such as a folder that has a scenario's name, and no run in it
            return LogSource(log_path(path))
        raise FleetError(f"{error}; nor is it a file or a directory") from None


def _newest(runs: Path) -> LiveSource | LogSource:
    below = runs.absolute()
    living = [one for one in registered_runs() if one.is_relative_to(below)] or near_ones(registered_runs())
    if found := [one for one in living if os.path.exists(one / OBSERVE)]:
        return _live(max(found, key=_began) / OBSERVE)
    if living:
        raise _not_published(max(living, key=_began))
    newest = newest_run(runs)
    if newest is None:
        if elsewhere := published_runs(OBSERVE):  # perhaps of another trial, which the page could disturb
            raise FleetError(f"no live run is below {below}; name one that is elsewhere: {elsewhere[0]}")
        raise FleetError(
            f"no run is live, and there is none below {runs.absolute()}: start one with fleet run paper --publish, or "
            "name a log or a run directory"
        )
    return LogSource(log_path(newest))


def _began(directory: Path) -> float:
    try:
        return os.stat(directory / SCENARIO).st_mtime
    except OSError:
        return 0.0


def _not_published(directory: Path) -> FleetError:
    return FleetError(
        f"the live run in {directory} is not published: start it with fleet run ... --publish; its log can be shown "
        f"when it is over, or as it is now: {directory / 'run.mcap'}"
    )


def _live(path: Path) -> LiveSource:
    try:
        observed = read_observed(path)
    except OSError as error:
        raise FleetError(f"cannot read {path}: {error.strerror}") from None
    except DamagedFile as error:
        raise FleetError(f"{path}: {error}") from None
    try:
        run = find(str(path.parent)) if path.name == OBSERVE else None
    except RemoteError:
        run = None
    return LiveSource(path.parent, observed, run)
