"""The argument LOG of commands, which may be left out: then the newest run is meant."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])
RUNS = Path("runs")  # where `fleet run` puts them


def log_argument(command: F) -> F:
    """Add the argument LOG; without it the newest run below `runs` is meant, which is named on stderr."""

    @wraps(command)
    def with_log(*arguments: Any, log: Path | None, **options: Any) -> Any:
        return command(*arguments, log=newest_log() if log is None else log, **options)

    argument = click.argument(
        "log", type=click.Path(path_type=Path), required=False,
        help="An MCAP file or a run directory; by default the newest run below runs.",
    )  # fmt: skip
    return argument(with_log)  # type: ignore[return-value]


def newest_log() -> Path:
    """The directory of the newest run below `runs`, named on stderr.

    Raises:
        click.UsageError: there is none.
    """
    from fleet.execution.directory import newest_run

    found = newest_run(RUNS)
    if found is None:
        raise click.UsageError(
            f"no log is given, and there is no run below {RUNS.absolute()}: name a log or a run directory, or go to "
            "the folder in which fleet run was called"
        )
    click.echo(f"fleet: the newest run: {found}", err=True)
    return found
