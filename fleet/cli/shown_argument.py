"""The argument RUN|LOG of commands that show either, and the rules about which options fit which."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from fleet.cli import completion
from fleet.cli.log_argument import RUNS

if TYPE_CHECKING:
    from fleet.view.source import LiveSource, LogSource

SHOWN = click.argument(
    "what", metavar="[RUN|LOG]", required=False, shell_complete=completion.published_runs,
    help="A live run that was started with --publish (its name, its scenario or its directory), an MCAP file, or "
         "a run directory. By default the live run that began last; if none lives, the newest run below runs.",
)  # fmt: skip


def find_shown(what: str | None, rate: float | None, *, control: bool, loop: bool) -> LiveSource | LogSource:
    """The run or the log to show.

    Args:
        what: as the argument `SHOWN` gives it.
        rate, control, loop: the options of these names; a log cannot be disturbed, and a live run has its own pace.

    Raises:
        click.UsageError: an option is for the other kind.
        FleetError: there is none, or the run is not published.
    """
    from fleet.view.source import LiveSource, LogSource, find_source

    source = find_source(what, RUNS)
    if isinstance(source, LogSource) and control:
        raise click.UsageError(f"--control needs a live run, not {source.path}: a log cannot be disturbed any more")
    if isinstance(source, LiveSource) and (rate is not None or loop):
        raise click.UsageError("--rate and --loop are for logs; fleet clock speed sets the pace of a live run")
    return source
