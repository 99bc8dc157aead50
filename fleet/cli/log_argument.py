"""The arguments LOG and RUN|LOG of commands, which may be left out: then the newest run is meant."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.cli import completion
from fleet.cli.completion import RUNS
from fleet.cli.types import Fallback
from fleet.option import Option

if TYPE_CHECKING:
    from fleet.addons.page.source import LiveSource, LogSource


def newest_log() -> Path:
    """The directory of the newest run below `runs`, named on stderr. Raises click.UsageError: there is none."""
    from fleet.execution.directory import newest_run

    found = newest_run(RUNS)
    if found is None:
        raise click.UsageError(
            f"no log is given, and there is no run below {RUNS.absolute()}: name a log or a run directory, or go to "
            "the folder in which fleet run was called"
        )
    click.echo(f"fleet: the newest run: {found}", err=True)
    return found


# Without it the newest run below `runs` is meant, which is named on stderr.
Log = Annotated[
    Path,
    Option("An MCAP file, a run directory or a bag of ROS 2; by default the newest run below runs."),
    Fallback(newest_log),
]
Shown = Annotated[str | None, completion.published_runs, Option(
    "A live run that was started with --publish (its name, its scenario or its directory), an MCAP file, or a run "
    "directory. By default the live run that began last; if none lives, the newest run below runs.",
    "[RUN|LOG]")]  # fmt: skip
LogRate = Annotated[float | None, click.FloatRange(0.001, 1000.0)]
LogLoop = Annotated[bool, Option("For a log: begin again at the end.", flag="-l --loop")]


def find_shown(what: str | None, rate: float | None, *, control: bool, loop: bool) -> LiveSource | LogSource:
    """The run or the log to show.

    Raises click.UsageError: a log cannot be disturbed, and a live run has its own pace; FleetError: there is none, or
    the run is not published.
    """
    from fleet.addons.page.source import LiveSource, LogSource, find_source

    source = find_source(what, RUNS)
    if isinstance(source, LogSource) and control:
        raise click.UsageError(f"--control needs a live run, not {source.path}: a log cannot be disturbed any more")
    if isinstance(source, LiveSource) and (rate is not None or loop):
        raise click.UsageError("--rate and --loop are for logs; fleet clock speed sets the pace of a live run")
    return source
