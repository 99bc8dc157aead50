"""The argument RUN|LOG of commands that show one, and may be left out: then the newest is meant."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import click

from fleet.cli import completion
from fleet.cli.completion import RUNS
from fleet.option import Option

if TYPE_CHECKING:
    from fleet.addons.page.source import LiveSource, LogSource

Shown = Annotated[str | None, completion.published_runs, Option(
    "A live run that was started with --publish (its name, its scenario or its directory), an MCAP file, or a run "
    "directory. By default the live run of this folder that began last; if none lives, the newest run below runs.",
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
