"""The command `fleet about`: everything that a bug report needs."""

from __future__ import annotations

from pathlib import Path

import click

from fleet.cli.log_argument import RUNS


@click.command()
@click.argument(
    "run", required=False, type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="A run directory; by default the newest run below runs, if there is one.",
)  # fmt: skip
def about(run: Path | None) -> None:
    """Print everything that a bug report needs: versions, the machine, its limits, and the result of RUN.

    It prints names of environment variables without their values, and `~` for your home directory. Read it before you
    send it: it contains names of folders and scenarios.

    \b
    Examples:
      fleet about
      fleet about runs/latest > report.txt
    """
    from fleet.bench.about import about as report
    from fleet.execution.directory import newest_run

    click.echo(report(run or (newest_run(RUNS) if RUNS.is_dir() else None)))


COMMANDS = (about,)
