"""The arguments LOG and RUN|LOG of commands, which may be left out: then the newest run is meant."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from fleet.cli import completion
from fleet.cli.completion import RUNS
from fleet.cli.types import PATH

if TYPE_CHECKING:
    from fleet.view.source import LiveSource, LogSource


F = TypeVar("F", bound=Callable[..., Any])


def log_argument(command: F) -> F:
    """Add the argument LOG; without it the newest run below `runs` is meant, which is named on stderr."""

    @wraps(command)
    def with_log(*arguments: Any, log: Path | None, **options: Any) -> Any:
        return command(*arguments, log=newest_log() if log is None else log, **options)

    argument = click.argument("log", type=PATH, required=False,
                              help="An MCAP file, a run directory or a bag of ROS 2; by default the newest "
                                   "run below runs.")  # fmt: skip
    return argument(with_log)  # type: ignore[return-value]


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


SHOWN = click.argument("what", metavar="[RUN|LOG]", required=False, shell_complete=completion.published_runs,
                       help="A live run that was started with --publish (its name, its scenario or its directory), an "
                            "MCAP file, or a run directory. By default the live run that began last; if none lives, "
                            "the newest run below runs.")  # fmt: skip


def find_shown(what: str | None, rate: float | None, *, control: bool, loop: bool) -> LiveSource | LogSource:
    """The run or the log to show.

    Raises click.UsageError: a log cannot be disturbed, and a live run has its own pace; FleetError: there is none, or
    the run is not published.
    """
    from fleet.view.source import LiveSource, LogSource, find_source

    source = find_source(what, RUNS)
    if isinstance(source, LogSource) and control:
        raise click.UsageError(f"--control needs a live run, not {source.path}: a log cannot be disturbed any more")
    if isinstance(source, LiveSource) and (rate is not None or loop):
        raise click.UsageError("--rate and --loop are for logs; fleet clock speed sets the pace of a live run")
    return source
