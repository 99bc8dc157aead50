"""The commands that list: `fleet list` the scenarios, `fleet ls` the runs, which it also removes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document
from fleet.cli.types import AGE, Whole, Words
from fleet.option import Option
from fleet.terminal.width import stdout

if TYPE_CHECKING:
    from rich.table import Table

    from fleet.execution.answers import LiveRunRow
    from fleet.execution.past_runs import PastRun


WIDE = 100  # columns from which on there is room for what the name says already
VERDICTS = ("pass", "fail", "broke", "stopped")


@command(document="fleet.cli.documents.logs.Runs")
def ls(
    *,
    out: Annotated[Path, Option("The folder with run directories.", "DIR", "-o --out")] = Path("runs"),
    prune: Annotated[bool, Option("Remove runs that are over: those that fit every option below.")] = False,
    keep: Annotated[int | None, Whole(min=0), Option("Keep the newest N of the runs that are over.", "N")] = None,
    older_than: Annotated[float | None, AGE, Option(
        "Only runs that began at least this long ago, e.g. '7 days'.")] = None,
    verdicts: Annotated[tuple[str, ...] | None, Words(VERDICTS), Option(
        f"Only runs with these verdicts: {', '.join(VERDICTS)}.", flag="--verdict")] = None,
    yes: Annotated[bool, Option("Remove them. Without it they are only listed.")] = False,
) -> None:  # fmt: skip
    """List the live runs of this user, then the runs below a directory, the newest first.

    Each row has the verdict, the simulated time, the size and the age of a run. The verdict is pass, FAIL, stopped,
    live, or broke; a run that is over without a result counts as broke. A directory that you renamed is not
    listed, and --prune leaves it and live runs alone. fleet list shows the scenarios.

    \b
    Examples:
      fleet ls
      fleet ls --out /data/runs --json
      fleet ls --prune --keep 20
      fleet ls --prune --older-than '7 days' --verdict fail,broke --yes
    """
    chosen = keep is not None or older_than is not None or verdicts is not None
    if prune:
        if json_is_asked():
            raise click.UsageError("--prune has no --json")
        if not chosen:
            wanted = "give --keep N, --older-than AGE or --verdict LIST; --keep 0 means all of them"
            raise click.UsageError(f"no runs chosen: {wanted}")
        _prune(out, keep or 0, older_than or 0.0, verdicts, yes=yes)
        return
    if chosen or yes:
        raise click.UsageError("--keep, --older-than, --verdict and --yes say what --prune removes: give it, too")
    from fleet.cli.documents.logs import Runs
    from fleet.execution.past_runs import LIVE, past_runs

    live, found = _live(), past_runs(out)
    size = sum(run.size for run in found)
    if json_is_asked():
        print_document(Runs(live, found, size))
        return
    for row in live:
        click.echo(row.error or f"{row.run}: t = {row.at_s:.1f} of {row.end_s:g} s, {row.clock}")
        click.echo(f"  {row.directory}, pid {row.pid}")
    if not found:
        click.echo(f"no run below {out}", err=True)
        return
    _show(found)
    alive = sum(run.verdict == LIVE for run in found)
    click.echo(f"{_runs(len(found))}, {_size(size)}{f', {alive} live' if alive else ''}")


def _live() -> list[LiveRunRow]:
    from fleet.execution.answers import LiveRunRow
    from fleet.execution.connection import RemoteError, ask, live_runs

    rows = []
    for found in live_runs():
        row = LiveRunRow(found.name, str(found.directory), found.scenario, found.pid, found.endpoint)
        try:
            values = ask(found, "status")
            row.at_s, row.end_s, row.clock = values["at_s"], values["end_s"], values["clock"]
        except RemoteError as error:
            row.error = str(error)
        rows.append(row)
    return rows


def _prune(out: Path, keep: int, older_than_s: float, verdicts: tuple[str, ...] | None, *, yes: bool) -> None:
    """Remove the runs that fit every given option. Without --yes they are only listed."""
    from fleet.execution.past_runs import FINISHED, past_runs, remove, to_prune

    chosen = [verdict for verdict in FINISHED if verdicts is None or verdict.lower() in verdicts]
    going = to_prune(past_runs(out), keep=keep, older_than_s=older_than_s, verdicts=chosen)
    if not going:
        click.echo(f"no run below {out} is to go", err=True)
        return
    if yes:
        gone = list(remove(out, going))
        click.echo(f"removed {_runs(len(gone))}, {_size(sum(run.size for run in gone))}")
        return
    _show(going)
    click.echo(f"would remove {_runs(len(going))}, {_size(sum(run.size for run in going))}; --yes does it")


def _show(runs: Sequence[PastRun]) -> None:
    from rich.table import Table

    terminal = stdout()
    wide = terminal.width >= WIDE
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
        table.add_row(*name, run.verdict, time, _size(run.size), _age(run.age_s))
    terminal.print(table)


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


@command("list", document="fleet.cli.listing.Listed")
def list_() -> None:
    """List the scenarios that ship with the package, by group, and what add-ons ship, such as studies.

    fleet ls lists the runs made of them.
    """
    from fleet.cli.listing import fill_listings, listing_document
    from fleet.scenario.catalogue import list_scenarios

    scenarios, others = list_scenarios(), fill_listings()
    if json_is_asked():
        print_document(
            listing_document(scenarios, {each.key: [row for row, _ in rows] for each, rows in others.items()})
        )
        return
    from rich.text import Text

    from fleet.scenario.schema.groups import GROUPS

    terminal = stdout()
    table = _table("scenario", "UUVs", "time", "expect", "what it shows")
    for group in GROUPS:
        table.add_row(Text(group, "bold"))
        for row in (row for row in scenarios if row.group == group):
            table.add_row(f"  {row.name}", str(row.vehicles), f"{row.duration_s:g} s", row.expect, row.title)
    terminal.print(table)
    for each, rows in others.items():
        if rows:
            terminal.print()
            table = _table(*each.headings)
            for _, cells in rows:
                table.add_row(*cells)
            terminal.print(table)


def _table(*headings: str) -> Table:
    """A table whose last column alone wraps."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, no_wrap=heading != headings[-1])
    return table
