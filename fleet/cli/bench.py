"""The commands that measure this machine: `fleet bench`, `bench real`, `bench scale`, `bench soak`, `bench stress`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from fleet.cli.group import ListingGroup
from fleet.cli.types import Numbers
from fleet.terminal.folding import stdout

_F = TypeVar("_F", bound=Callable[..., Any])
SIZES = Numbers(1, 1000, "4,20,100", whole=True)


def _writable(_: click.Context, __: click.Parameter, path: Path | None) -> Path | None:
    """Refuse a file that cannot be written before an hour of measuring, not after it."""
    if path is not None and path.name.startswith("-"):
        raise click.BadParameter(f"expected the file to write, got the option {path}")
    if path is not None and (path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK)):
        raise click.BadParameter(f"{path} cannot be written: it is a directory, is in none, or is not yours")
    return path


_json = click.option(
    "--json", "json_path", type=click.Path(path_type=Path, dir_okay=False), callback=_writable,
    help="Also write all figures here.",
)  # fmt: skip
_quick = click.option("--quick", is_flag=True, help="A few ticks each: shows that it works, measures little.")


def _agents(default: str) -> Callable[[_F], _F]:
    return click.option(
        "--agents", metavar="N,N,...", type=SIZES, default=default, show_default=True, help="Fleet sizes."
    )


@click.group(cls=ListingGroup, invoke_without_command=True)
@_agents("4,20,100")
@_json
@_quick
@click.pass_context
def bench(context: click.Context, agents: list[int], json_path: Path | None, quick: bool) -> None:
    """Measure this machine: the fleet against a bare zenoh barrier and OS pipes.

    \b
    Examples:
      fleet bench
      fleet bench --agents 4 --json bench.json
      fleet bench real --agents 4,20 --speed 1,4
    """
    if context.invoked_subcommand is not None:
        return
    from fleet.bench.fleets import measure_fleets
    from fleet.bench.tables import show

    figures = measure_fleets(agents, quick=quick, say=_say)
    show(figures, stdout())
    _write(json_path, figures)


@bench.command()
@_agents("4,10,20,40")
@click.option(
    "--speed", "speeds", metavar="X,X,...", type=Numbers(0.01, 100.0, "1,2,5"), default="1,2,5", show_default=True,
    help="Times real time; 1 is 100 ticks/s.",
)  # fmt: skip
@_json
@_quick
def real(agents: list[int], speeds: list[float], json_path: Path | None, quick: bool) -> None:
    """Find where --clock real falls behind on this machine, and what lockstep makes of the same.

    \b
    Examples:
      fleet bench real
      fleet bench real --agents 4,100 --speed 0.5,1
    """
    from fleet.bench.wall_clock import measure_wall_clock, show_wall_clock

    rows = measure_wall_clock(agents, speeds, seconds=1.0 if quick else 10.0, say=_say)
    show_wall_clock(rows, stdout())
    _write(json_path, [row.to_values() for row in rows])


@bench.command()
@_agents("100,300")
@click.option(
    "--suspend", metavar="SECONDS", type=click.FloatRange(0.1, 3600.0), default=30.0, show_default=True,
    help="How long the console is stopped.",
)  # fmt: skip
@_json
def stress(agents: list[int], suspend: float, json_path: Path | None) -> None:
    """Try large fleets, floods by an agent, a stopped console and a reader that never reads.

    \b
    Examples:
      fleet bench stress
      fleet bench stress --agents 20 --suspend 1
    """
    from fleet.bench.stress import measure_stress, stress_failures, stress_table

    rows = measure_stress(agents, suspend, _say)
    stdout().print(stress_table(rows))
    _write(json_path, [row.to_values() for row in rows])
    _end(stress_failures(rows))


@bench.command()
@click.option("--vehicles", type=click.IntRange(2, 1000), default=20, show_default=True, help="Fleet size.")
@click.option(
    "--duration", metavar="SECONDS", type=click.FloatRange(30.0, 1e6), default=3600.0, show_default=True,
    help="Simulated, in one process.",
)  # fmt: skip
@click.option(
    "--distributed", metavar="SECONDS", type=click.FloatRange(30.0, 1e6), default=300.0, show_default=True,
    help="Simulated, distributed.",
)  # fmt: skip
@_json
def soak(vehicles: int, duration: float, distributed: float, json_path: Path | None) -> None:
    """Run for long under random faults: is memory flat, the ledger balanced, the digest the same, nobody left?

    \b
    Examples:
      fleet bench soak
      fleet bench soak --vehicles 6 --duration 120 --distributed 60
    """
    from fleet.bench.soak import measure_soak, show_soak, soak_failures

    rows = measure_soak(vehicles, duration, distributed, _say)
    show_soak(rows, stdout())
    _write(json_path, [row.to_values() for row in rows])
    _end(soak_failures(rows))


@bench.command()
@_agents("4,20,100,300,1000")
@click.option("--tick", metavar="TIME", default="100 ms", show_default=True, help="Of the scenario, with its unit.")
@click.option(
    "--picture", type=click.Path(path_type=Path, dir_okay=False), callback=_writable,
    help="Also draw the curve here, as PNG.",
)  # fmt: skip
@_json
@_quick
def scale(agents: list[int], tick: str, picture: Path | None, json_path: Path | None, quick: bool) -> None:
    """Measure what a tick of an agent costs by the size of the fleet, each row as soon as it is there.

    \b
    Examples:
      fleet bench scale
      fleet bench scale --agents 4,100 --tick '10 ms' --picture scale.png
    """
    from fleet.bench.scale import measure_scale
    from fleet.bench.scale_picture import HEADING, draw, line

    rows: list[Any] = []
    for row in measure_scale(agents, tick, quick=quick, say=_say):
        click.echo(line(row) if rows else f"{HEADING}\n{line(row)}")
        rows.append(row)
    _write(json_path, [row.to_values() for row in rows])
    if picture is not None:
        draw(rows, picture)


def _end(wrong: list[str]) -> None:
    for line in wrong:
        click.echo(f"FAIL  {line}")
    sys.exit(1 if wrong else 0)


def _say(text: str) -> None:
    click.echo(text, err=True)


def _write(path: Path | None, figures: Any) -> None:
    if path is not None:
        path.write_text(json.dumps(figures, indent=2) + "\n", "utf-8")


COMMANDS = (bench,)
