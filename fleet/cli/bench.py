"""The commands that measure this machine: `fleet bench`, and those below it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from fleet.cli.documents.output import json_option, print_document
from fleet.cli.group import ListingGroup
from fleet.cli.types import Numbers, Whole
from fleet.terminal.table import stdout

if TYPE_CHECKING:
    from msgspec import Struct

    from fleet.bench.figures import FiguresComparison

_F = TypeVar("_F", bound=Callable[..., Any])
SIZES = Numbers(1, 3000, "4,20,100", whole=True)


def _writable(_: click.Context, __: click.Parameter, path: Path | None) -> Path | None:
    """Refuse a file that cannot be written before an hour of measuring, not after it."""
    if path is not None and path.name.startswith("-"):
        raise click.BadParameter(f"expected the file to write, got the option {path}")
    if path is not None and (path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK)):
        raise click.BadParameter(
            f"{path} cannot be written: it is a directory, its folder is missing, or you may not write there"
        )
    return path


_output = click.option(
    "-o", "--output", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False), callback=_writable,
    help="Also write what --json prints into a file.",
)  # fmt: skip
_quick = click.option("--quick", is_flag=True, help="Only a few ticks each: a trial, no measurement.")
_file = click.Path(path_type=Path)


def _agents(default: str) -> Callable[[_F], _F]:
    return click.option(
        "--agents", metavar="N,N,...", type=SIZES, default=default, show_default=True, help="Fleet sizes."
    )


@click.group(cls=ListingGroup, invoke_without_command=True)
@_agents("4,20,100")
@click.option(
    "--compare", "old", metavar="OLD.json", type=_file, help="Print the figures that got slower or faster since then."
)
@_output
@json_option
@_quick
@click.pass_context
def bench(
    context: click.Context, agents: list[int], old: Path | None, output: Path | None, as_json: bool, quick: bool
) -> None:
    """Measure this machine: the fleet against a bare zenoh barrier and OS pipes.

    It takes some minutes, and needs an idle machine. With --compare the exit status is 1 if a figure got slower by
    more than the noise.

    \b
    Examples:
      fleet bench
      fleet bench --agents 4 -o old.json
      fleet bench --agents 4 --compare old.json
      fleet bench real --agents 4,20 --speed 1,4
    """
    if context.invoked_subcommand is not None:
        return
    from fleet.bench.comparison import compare, read
    from fleet.bench.fleets import measure_fleets
    from fleet.bench.tables import show, show_comparison

    before = None if old is None else read(old)  # refused now, not after some minutes
    measured = measure_fleets(agents, quick=quick, say=_say)
    if old is not None and before is not None:
        measured.comparison = compare(before, measured, old)
    _give(measured, output, as_json=as_json)
    if not as_json:
        show(measured, stdout())
        if measured.comparison:
            show_comparison(measured.comparison, stdout())
    _end_compared(measured.comparison)


@bench.command("compare")
@click.argument("old", metavar="OLD.json", type=_file)
@click.argument("new", metavar="NEW.json", type=_file)
@json_option
def compare_(old: Path, new: Path, as_json: bool) -> None:
    """Compare two files of fleet bench -o; nothing is measured.

    The exit status is 1 if something got slower by more than the noise: the repeats of a figure do not overlap, and
    their medians are further apart than the repeats, and than 10 %. Ratios to the baselines of the same minute count,
    not seconds.

    \b
    Examples:
      fleet bench compare old.json new.json
      fleet bench compare plain.json compiled.json --json | jq '.comparison.changes[] | select(.verdict != "same")'
    """
    from fleet.bench.comparison import compare, read
    from fleet.bench.figures import ComparedFiles
    from fleet.bench.tables import show_comparison

    found = compare(read(old), read(new), old)
    if as_json:
        print_document(ComparedFiles(found))
    else:
        show_comparison(found, stdout())
    _end_compared(found)


@bench.command()
@_agents("4,10,20,40")
@click.option(
    "--speed", "speeds", metavar="X,X,...", type=Numbers(0.01, 100.0, "1,2,5"), default="1,2,5", show_default=True,
    help="Times real time; 1 is 100 ticks/s.",
)  # fmt: skip
@_output
@json_option
@_quick
def real(agents: list[int], speeds: list[float], output: Path | None, as_json: bool, quick: bool) -> None:
    """Find the load at which --clock real falls behind on this machine, and compare lockstep.

    \b
    Examples:
      fleet bench real
      fleet bench real --agents 4,100 --speed 0.5,1
    """
    from fleet.bench.wall_clock import OnWallClock, measure_wall_clock, show_wall_clock

    rows = measure_wall_clock(agents, speeds, seconds=1.0 if quick else 10.0, say=_say)
    _give(OnWallClock(rows), output, as_json=as_json)
    if not as_json:
        show_wall_clock(rows, stdout())


@bench.command()
@_agents("4,20,100,300,1000")
@click.option("--tick", metavar="TIME", default="100 ms", show_default=True, help="Of the scenario, with its unit.")
@click.option("--per-process", metavar="N", default="1", show_default=True,
              help="Agents in a process, as agents.per_process of a scenario: a number, or auto.")  # fmt: skip
@click.option(
    "--picture", type=click.Path(path_type=Path, dir_okay=False), callback=_writable,
    help="Also draw the curve here, as PNG.",
)  # fmt: skip
@_output
@json_option
@_quick
def scale(
    agents: list[int],
    tick: str,
    per_process: str,
    picture: Path | None,
    output: Path | None,
    as_json: bool,
    quick: bool,
) -> None:
    """Measure the cost of an agent's tick for several fleet sizes; each row is printed when it is ready.

    \b
    Examples:
      fleet bench scale
      fleet bench scale --agents 4,100 --tick '10 ms' --picture scale.png
      fleet bench scale --agents 100,300,1000 --per-process 25
    """
    from fleet.bench.scale import Scaled, ScaleRow, measure_scale
    from fleet.bench.scale_picture import HEADING, draw, line

    rows: list[ScaleRow] = []
    for row in measure_scale(agents, tick, per_process, quick=quick, say=_say):
        click.echo(line(row) if rows else f"{HEADING}\n{line(row)}", err=as_json)
        rows.append(row)
    _give(Scaled(rows), output, as_json=as_json)
    if picture is not None:
        draw(rows, picture)


@bench.command()
@click.option("--runs", type=Whole(1), default=20, show_default=True, help="Of each repeat; there are three.")
@click.option(
    "--duration", metavar="SECONDS", type=click.FloatRange(0.01, 1e6), default=20.0, show_default=True,
    help="Of a run, simulated.",
)  # fmt: skip
@click.option("--workers", metavar="N", type=Whole(1, 1024), default=2, show_default=True,
              help="Measure so many workers besides one.")  # fmt: skip
@click.option("--memory", metavar="RUNS", type=Whole(10),
              help="Instead, make so many short runs with one worker, and say how much memory it takes.")  # fmt: skip
@_output
@json_option
def study(runs: int, duration: float, workers: int, memory: int | None, output: Path | None, as_json: bool) -> None:
    """Measure the cost of a study's run compared with a bare run, and the gain by more workers.

    The runs of fleet sweep, and of fleet search and shrink, are compared with concurrent.futures. Needs
    pip install 'uuv-fleet[study]'.

    \b
    Examples:
      fleet bench study
      fleet bench study --runs 5 --duration 60
      fleet bench study --memory 10000
    """
    from fleet.bench.studies import measure_memory, measure_study, show_memory, show_study
    from fleet.study.engine import need_extra

    need_extra()
    if memory is not None:
        many = measure_memory(memory)
        _give(many, output, as_json=as_json)
        if not as_json:
            show_memory(many, stdout())
        return
    measured = measure_study(runs, duration, workers, say=_say)
    _give(measured, output, as_json=as_json)
    if not as_json:
        show_study(measured, stdout())


def _give(document: Struct, output: Path | None, *, as_json: bool) -> None:
    """Print a document, or write it, or both."""
    if output is not None:
        from fleet.result.result import json_text

        output.write_text(json_text(document) + "\n", "utf-8")
    if as_json:
        print_document(document)


def _end_compared(found: FiguresComparison | None) -> None:
    sys.exit(1 if found is not None and found.slower else 0)


def _say(text: str) -> None:
    click.echo(text, err=True)


COMMANDS = (bench,)
