"""The commands for the runs below a directory: ls and prune."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fleet.cli.documents.output import json_option, print_document
from fleet.cli.types import AgeText, Whole, Words
from fleet.terminal.table import stdout

if TYPE_CHECKING:
    from rich.table import Table

    from fleet.execution.directory import PastRun

WIDE = 100  # columns from which on there is room for what the name says already
VERDICTS = ("pass", "fail", "broke", "stopped")
_out = click.option(
    "--out", metavar="DIR", type=click.Path(path_type=Path), default=Path("runs"), show_default=True,
    help="The folder with run directories.",
)  # fmt: skip


@click.command()
@_out
@json_option
def ls(out: Path, as_json: bool) -> None:
    """List the runs below a directory, the newest first.

    Each row has the verdict, the simulated time, the size and the age of a run. The verdict is pass, FAIL, stopped,
    live, or broke; a run that is over without a result counts as broke. A directory that you renamed is not
    listed. fleet ps lists live runs in any folder. fleet list shows the scenarios.

    \b
    Examples:
      fleet ls
      fleet ls --out /data/runs --json
    """
    from fleet.cli.documents.listing import RunRow, Runs
    from fleet.execution.directory import LIVE, past_runs

    found, now = past_runs(out), _now()
    size = sum(run.size for run in found)
    if as_json:
        rows = [
            RunRow(run.name, str(run.path), run.scenario, run.verdict, run.sim_s, run.size, run.began.isoformat(),
                   (now - run.began).total_seconds())
            for run in found
        ]  # fmt: skip
        print_document(Runs(rows, size))
        return
    if not found:
        click.echo(f"no run below {out}", err=True)
        return
    terminal = stdout()
    terminal.print(_table(found, now, wide=terminal.width >= WIDE))
    live = sum(run.verdict == LIVE for run in found)
    click.echo(f"{_runs(len(found))}, {_size(size)}{f', {live} live' if live else ''}")


@click.command()
@_out
@click.option("--keep", metavar="N", type=Whole(min=0), help="Keep the newest N of the runs that are over.")
@click.option(
    "--older-than", metavar="AGE", type=AgeText(), help="Only runs that began at least this long ago, e.g. '7 days'."
)
@click.option(
    "--verdict",
    "verdicts",
    metavar="LIST",
    type=Words(VERDICTS),
    help=f"Only runs with these verdicts: {', '.join(VERDICTS)}.",
)
@click.option("--yes", is_flag=True, help="Remove them. Without it they are only listed.")
def prune(out: Path, keep: int | None, older_than: float | None, verdicts: tuple[str, ...] | None, yes: bool) -> None:
    """Remove runs that are over, with their directories.

    The command removes the runs that fit every given option. Without --yes it only lists them. Live runs and renamed
    directories stay: rename a run to keep it.

    \b
    Examples:
      fleet prune --keep 20
      fleet prune --older-than '7 days' --verdict fail,broke --yes
    """
    from fleet.execution.directory import FINISHED, past_runs, remove, to_prune

    if keep is None and older_than is None and verdicts is None:
        raise click.UsageError(
            "no runs chosen: give --keep N, --older-than AGE or --verdict LIST; --keep 0 means all of them"
        )
    now = _now()
    chosen = [verdict for verdict in FINISHED if verdicts is None or verdict.lower() in verdicts]
    going = to_prune(past_runs(out), keep=keep or 0, older_than_s=older_than or 0.0, verdicts=chosen, now=now)
    if not going:
        click.echo(f"no run below {out} is to go", err=True)
        return
    if yes:
        gone = list(remove(out, going))
        click.echo(f"removed {_runs(len(gone))}, {_size(sum(run.size for run in gone))}")
        return
    terminal = stdout()
    terminal.print(_table(going, now, wide=terminal.width >= WIDE))
    click.echo(f"would remove {_runs(len(going))}, {_size(sum(run.size for run in going))}; --yes does it")


def _table(runs: Sequence[PastRun], now: datetime, *, wide: bool) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    table.add_column("run", overflow="fold")
    if wide:
        table.add_column("scenario", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for heading in ("time", "size", "age"):
        table.add_column(heading, justify="right", no_wrap=True)
    for run in runs:
        time = "-" if run.sim_s is None else f"{run.sim_s:g} s"
        name = [run.name, run.scenario] if wide else [run.name]
        table.add_row(*name, run.verdict, time, _size(run.size), _age((now - run.began).total_seconds()))
    return table


def _now() -> datetime:
    return datetime.now(UTC)  # noqa: TID251 (the ages of files, by the clock that gave them their names)


def _runs(count: int) -> str:
    return f"{count} run{'' if count == 1 else 's'}"


def _size(size: int) -> str:
    return f"{size / 1e9:.2f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


def _age(seconds: float) -> str:
    for size, unit in ((86_400, "day"), (3600, "h"), (60, "min")):
        if seconds >= size:
            count = int(seconds // size)
            return f"{count} {unit}{'s' if unit == 'day' and count > 1 else ''}"
    return f"{max(0, int(seconds))} s"


COMMANDS = (ls, prune)
