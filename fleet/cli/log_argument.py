"""The argument LOG of commands, which may be left out: then the newest run is meant."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated

import click

from fleet.cli.completion import RUNS
from fleet.cli.types import Fallback, is_given
from fleet.option import Option


def newest_log() -> Path:
    """The directory of the newest run below `runs`, named on stderr. Raises click.UsageError: there is none."""
    from fleet.execution.past_runs import newest_run

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


def check_options(subject: Path, names: Collection[str], only_for: str) -> None:
    """Refuse options that were given, by their parameters, if they are for what the subject is not: UsageError."""
    options = click.get_current_context().command.params
    given = [each.opts[-1] for each in options if each.name in names and is_given(each.name)]
    if given:
        raise click.UsageError(f"{', '.join(given)}: only for {only_for}; {subject} is none")
