"""The command `fleet report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import click

from fleet.addons.pictures.verbs.choice import OF_STUDIES, PictureChoice, find_drawer
from fleet.cli.declare import command
from fleet.cli.log_argument import check_options, newest_log
from fleet.cli.types import (
    FILE,
    Force,
    NoProgress,
)
from fleet.option import Option
from fleet.terminal.progress import showing
from fleet.terminal.width import say


@command()
def report(
    logs: Annotated[tuple[Path, ...], Option(
        "MCAP files or run directories; by default the newest run below runs.", "[LOG]...")] = (),
    *,
    out: Annotated[Path, FILE, Option("The page.", flag="-o --out")] = Path("report.html"),
    force: Force = False,
    shown: PictureChoice,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Write one self-contained HTML page about one LOG, or about several and what they have in common.

    The page has the scenario, conditions of the links, and faults. From result.json next to the log it takes verdicts,
    vehicles, ledger and ages. It ends with pictures, and how to repeat the run. It needs no network and no other file.

    The page about a study's directory has its settings and cost, pictures, every point with intervals, comparisons in
    pairs, and the reasons of runs without a result. It also says how to make a run again.

    \b
    Examples:
      fleet report
      fleet report runs/a runs/b -o compared.html --log-scale
      fleet report studies/rough-sea-20261122-101500 -o study.html
    """
    from fleet.addons.pictures.page import check_place
    from fleet.addons.pictures.report import write
    from fleet.addons.pictures.runs import View, check_view, load

    check_place(out, force=force)
    chosen = logs or (newest_log(),)
    for path in chosen:
        if (other := find_drawer(path)) is None:
            continue
        if len(chosen) > 1:
            raise click.UsageError(f"{path} is {other.name}: a page is about {other.name} alone, or about logs")
        check_options(path, {*other.refused} & {*OF_STUDIES}, "studies")
        check_options(path, {*other.refused} - {*OF_STUDIES}, "logs of runs")
        other.report(path, out, shown)
        click.echo(out)
        return
    check_options(chosen[0], OF_STUDIES, "studies")
    with showing("reading") as on_progress:
        runs = load(chosen, on_progress)
    view = View(shown.vehicles, shown.log_scale, shown.window)
    check_view(runs, view)
    with showing("drawing and adding up") as on_progress:
        write(out, runs, view, on_progress)
    for run in runs:
        if run.log.missing:
            say(f"fleet: {run.label}: {run.log.missing}", err=True)
    click.echo(out)
