"""The command `fleet reproduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import click

from fleet.cli.declare import command
from fleet.cli.group import exit_status
from fleet.cli.types import FOLDER, Whole
from fleet.option import Option
from fleet.processes.limits import processors
from fleet.terminal.progress import showing_jobs
from fleet.terminal.width import stdout


@command()
def reproduce(
    *,
    out: Annotated[Path, FOLDER, Option("The folder for report.md, metrics.json and the pictures.")] = (
        Path("reproduction")),
    jobs: Annotated[int | None, Whole(1, 256), Option("Runs at a time; by default one per core.", "N")] = None,
    cases: Annotated[tuple[str, ...], Option(
        "Only runs whose name begins with NAME; repeatable.", "NAME", "--case")] = (),
    formats: Annotated[tuple[Literal["png", "svg", "pdf"], ...], Option(
        "Format of the pictures; repeatable.", flag="--format")] = ("png",),
) -> None:  # fmt: skip
    """Run the paper's simulation section again and judge each of its claims.

    The runs cover five controllers, undisturbed and disturbed, with the printed and the corrected cost, with and
    without a network. The command draws every figure of the paper, and writes a report with a verdict on every claim.
    That takes 170 s of CPU time: one and a half minutes on two idle cores.

    \b
    Examples:
      fleet reproduce
      fleet reproduce --out /tmp/paper --jobs 4 --format png --format pdf
      fleet reproduce --case nboc --case nbc-disturbed
    """
    from rich.table import Table

    from fleet.addons.paper.cases import CASES

    names = [name for name in CASES if not cases or any(name.lower().startswith(c.lower()) for c in cases)]
    for case in cases:
        if not any(name.lower().startswith(case.lower()) for name in CASES):
            raise click.BadParameter(f"no run begins with {case!r}; there are {', '.join(CASES)}", param_hint="--case")
    from fleet.addons.paper.run import reproduce as run_all

    with exit_status(3), showing_jobs() as on_progress:
        path, claims, _ = run_all(out, jobs or processors(), names, formats, on_progress)
    table = Table(box=None, pad_edge=False)
    for heading in ("verdict", "claim", "under which reading"):
        table.add_column(heading)
    colours = {"reproduced": "green", "partly": "yellow", "not reproduced": "red"}
    for claim in claims:
        table.add_row(f"[{colours[claim.verdict]}]{claim.verdict}[/]", claim.text, claim.readings)
    output = stdout()
    if claims:
        output.print(table)
    else:
        output.print("no claim can be judged on these runs alone", highlight=False)
    output.print(str(path), highlight=False, soft_wrap=True)
