"""The command `fleet status`, once or again and again in place."""

from __future__ import annotations

import time
from contextlib import nullcontext
from typing import TYPE_CHECKING

import click

from fleet.cli.documents.output import json_option, print_document
from fleet.cli.run_argument import answer, run_argument
from fleet.terminal.table import stdout

if TYPE_CHECKING:
    from rich.console import Console, Group
    from rich.table import Table

    from fleet.cli.documents.live import FaultRow, LinkRow, RunStatus, VehicleRow
    from fleet.execution.connection import LiveRun

EVERY_S = 1.0
MOST_FAULTS = 5
MOST_EVENTS = 3


@click.command()
@run_argument
@click.option("-w", "--watch", is_flag=True, help="Repeat every second, until the run is over or Ctrl-C.")
@click.option("--all", "every", is_flag=True, help="All vehicles, links and faults, not only the worst and active.")
@json_option
def status(run: str | None, watch: bool, every: bool, as_json: bool) -> None:
    """Show the state of a live run.

    It prints the time, the processes that the run waits for, active faults with their ids, the fate of vehicles, and
    the worst vehicles and links. "oldest news" is the greatest age of a vehicle's last message from a neighbour. e is
    the consensus error. fleet info shows the log of a run.

    \b
    Examples:
      fleet status
      fleet status paper --all
      fleet status -w paper-1-20261121-120000
    """
    if watch and as_json:
        raise click.UsageError("--json prints one document, and --watch many: give one of them")
    from fleet.execution.connection import find

    found = find(run)
    if as_json:
        print_document(_status(found, every))
        return
    terminal = stdout()
    if watch:
        watch_run(found, every, terminal)
    else:
        terminal.print(screen(_status(found, every), every))


def _status(found: LiveRun, every: bool) -> RunStatus:
    from fleet.cli.documents.live import RunStatus

    return answer(RunStatus, found, "status", all=every)


def watch_run(found: LiveRun, every: bool, terminal: Console) -> None:
    """Show it again and again: on a terminal in place, on a screen of its own; elsewhere one block after the other."""
    from rich.live import Live

    from fleet.execution.connection import RemoteError, is_live
    from fleet.terminal.status_line import rewritable

    in_place = rewritable(terminal) and not terminal.is_dumb_terminal
    values = _status(found, every)
    try:
        with Live(console=terminal, screen=True, auto_refresh=False) if in_place else nullcontext() as live:
            while True:
                if live is None:
                    terminal.print(screen(values, every), "")
                else:
                    live.update(screen(values, every, terminal.height), refresh=True)
                time.sleep(EVERY_S)
                try:
                    values = _status(found, every)
                except RemoteError:
                    if is_live(found):
                        raise
                    break
    finally:
        if in_place:
            terminal.print(screen(values, every))  # the screen of its own is gone; what it showed last stays
    click.echo(f"{found.name}: the run is over; its results are in {found.directory}")


def screen(status: RunStatus, every: bool, height: int | None = None) -> Group:
    """A status as a terminal shows it, in 80 columns.

    Args:
        every: the user asked for all vehicles and links.
        height: of the screen that the text must fit [lines]; None: any length.
    """
    from rich.console import Group
    from rich.text import Text

    lines = [
        f"{status.run}: t = {status.at_s:.2f} of {status.end_s:g} s, {status.clock}",
        f"formation error {status.formation}",
        f"packets {status.delivered} delivered, {status.lost} lost",
    ]
    if status.waiting not in ("", status.clock):
        lines.append(status.waiting)
    whole = every and height is None
    faults, events = (None, None) if whole else (MOST_FAULTS, MOST_EVENTS)
    lines += [_fault(fault, status) for fault in status.faults[:faults]]
    if faults is not None and len(status.faults) > faults:
        lines.append(f"and {_more(len(status.faults) - faults, 'fault')}: fleet status --all")
    lines += [f"event {event}" for event in status.events[:events]]
    if events is not None and len(status.events) > events:
        lines.append(f"and events of {_more(len(status.events) - events, 'vehicle')}: fleet status --all")
    vehicles, links = status.vehicles, status.links
    if height is not None:
        room = height - len(lines) - 3  # two headings, and a line on what is left out
        links = links[: max(room // 3, room - len(vehicles), 1)]
        vehicles = _worst(vehicles, max(room - len(links), 1))
    parts = [Text(line, overflow="ellipsis", no_wrap=height is not None) for line in lines]
    left_out = [
        _more(total - shown, what)
        for what, shown, total in (
            ("vehicle", len(vehicles), status.vehicles_total),
            ("link", len(links), status.links_total),
        )
        if shown < total
    ]
    tail = [Text(f"and {' and '.join(left_out)}{'' if every else ': --all'}")] if left_out else []
    return Group(*parts, _vehicles(vehicles), _links(links), *tail)


def _more(count: int, what: str) -> str:
    return f"{count} more {what}{'' if count == 1 else 's'}"


def _worst(vehicles: list[VehicleRow], most: int) -> list[VehicleRow]:
    """Those with the greatest formation errors, in their order."""
    from fleet.execution.operator import badness

    worst = sorted(vehicles, key=lambda row: -badness(row.formation_m))[:most]
    return sorted(worst, key=lambda row: row.vehicle)


def _fault(fault: FaultRow, status: RunStatus) -> str:
    if fault.state != "active":
        return f"fault {fault.id}: {fault.state}, {fault.from_s:.2f} s to {fault.to_s:.2f} s: {fault.what}"
    left = f"{max(0.0, fault.to_s - status.at_s):.1f} s left"
    if fault.to_s >= status.end_s:
        left = "until healed" if fault.until_healed else "to the end"
    return f"fault {fault.id}: {left}: {fault.what}"


def _vehicles(rows: list[VehicleRow]) -> Table:
    table = _table("UUV", "state", "formation error", "e", "settled", "oldest news")
    for row in rows:
        news = "-" if row.oldest_s is None else f"{row.oldest_s:.2f} s, of {row.oldest_of}"
        errors = ("-" if value is None else f"{value:.3f} m" for value in (row.formation_m, row.e_m))
        table.add_row(str(row.vehicle), row.state, *errors, "yes" if row.settled else "no", news)
    return table


def _links(rows: list[LinkRow]) -> Table:
    table = _table("link", "delivered", "lost", "share", "age")
    for row in rows:
        counts = str(row.delivered), str(row.lost), f"{100 * row.lost_share:.1f} %"
        table.add_row(f"{row.src}->{row.dst}", *counts, f"{row.age_s:.2f} s")
    return table


def _table(first: str, *others: str) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    table.add_column(first, no_wrap=True)
    for heading in others:
        table.add_column(heading, justify="left" if heading == "state" else "right", no_wrap=True)
    return table


COMMANDS = (status,)
