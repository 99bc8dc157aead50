"""Measures this machine: `python -m benchmarks`, in a checkout."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if __name__ == "__main__":
    sys.path.append(sys.path.pop(0))  # the checkout; first what is installed: its cores may be compiled

import click
import msgspec
from msgspec import Struct

from benchmarks.figures import Comparison, compare, read, show_comparison, show_figures
from fleet.cli.types import Whole, numbers
from fleet.errors import FleetError
from fleet.terminal.width import stdout

if TYPE_CHECKING:
    from benchmarks.scale import ScaleRow

_File = click.Path(path_type=Path, dir_okay=False)
_output = click.option("-o", "--out", metavar="FILE", type=click.File("w", lazy=False), help="Also write the JSON.")
_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")
_quick = click.option("--quick", is_flag=True, help="Only a few ticks each: a trial, no measurement.")


def _agents(default: str) -> Callable[[Any], Any]:
    sizes = numbers(1, 3000, "4,20,100", whole=True)
    return click.option("--agents", metavar="N,N,...", type=sizes, default=default, show_default=True)


class _Group(click.Group):
    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except FleetError as error:
            click.echo(f"benchmarks: {error}", err=True)
            ctx.exit(error.status)
        except KeyboardInterrupt:
            ctx.exit(130)


@click.group(cls=_Group, invoke_without_command=True)
@_agents("4,20,100")
@click.option("--compare", "old", metavar="OLD.json", type=_File, help="Print what got slower or faster since then.")
@_output
@_json
@_quick
@click.pass_context
def main(context: click.Context, agents: list[int], old: Path | None, out: Any, as_json: bool, quick: bool) -> None:
    """Measure this machine: the fleet against a bare zenoh barrier.

    It takes some minutes, and needs an idle machine. With --compare the exit status is 1 if a figure got slower by
    more than the noise.
    """
    if context.invoked_subcommand is not None:
        return
    from benchmarks.fleets import measure_fleets

    before = None if old is None else read(old)  # refused now, not after some minutes
    measured = measure_fleets(agents, quick=quick, say=_say)
    if old is not None and before is not None:
        measured.comparison = compare(before, measured, old)
    _give(measured, out, as_json, lambda: show_figures(measured, stdout()))
    if measured.comparison is not None:
        _compared(measured.comparison, as_json)


@main.command("compare")
@click.argument("old", metavar="OLD.json", type=_File)
@click.argument("new", metavar="NEW.json", type=_File)
def compare_(old: Path, new: Path) -> None:
    """Compare two files of -o; nothing is measured. The exit status is 1 if something got slower."""
    _compared(compare(read(old), read(new), old), False)


def _compared(found: Comparison, as_json: bool) -> None:
    if not as_json:
        show_comparison(found, stdout())
    sys.exit(1 if found.slower else 0)


@main.command()
@_agents("4,20,100,300,1000")
@click.option("--tick", metavar="TIME", default="100 ms", show_default=True, help="Of the scenario, with its unit.")
@click.option("--per-process", metavar="N", default="1", show_default=True,
              help="Agents in a process, as agents.per_process of a scenario: a number, or auto.")  # fmt: skip
@_output
@_json
@_quick
def scale(agents: list[int], tick: str, per_process: str, out: Any, as_json: bool, quick: bool) -> None:
    """Measure the cost of an agent's tick for several fleet sizes; each row is printed when it is ready."""
    from benchmarks.scale import HEADING, line, measure_scale

    rows: list[ScaleRow] = []
    for row in measure_scale(agents, tick, per_process, quick=quick, say=_say):
        click.echo(line(row) if rows else f"{HEADING}\n{line(row)}", err=as_json)
        rows.append(row)
    _give({"rows": rows}, out, as_json, lambda: None)


@main.command()
@click.option("--runs", type=Whole(1), default=20, show_default=True, help="Of each repeat; there are three.")
@click.option("--duration", metavar="SECONDS", type=click.FloatRange(0.01, 1e6), default=20.0, show_default=True,
              help="Of a run, simulated.")  # fmt: skip
@click.option("--workers", metavar="N", type=Whole(1, 1024), default=2, show_default=True,
              help="Measure so many workers besides one.")  # fmt: skip
@click.option("--memory", metavar="RUNS", type=Whole(10),
              help="Instead, make so many short runs with one worker, and say how much memory it takes.")  # fmt: skip
@_output
@_json
def study(runs: int, duration: float, workers: int, memory: int | None, out: Any, as_json: bool) -> None:
    """Measure the cost of a study's run compared with a bare run, and the gain by more workers."""
    from benchmarks.studies import measure_memory, measure_study, show_memory, show_study

    if memory is not None:
        many = measure_memory(memory)
        _give(many, out, as_json, lambda: show_memory(many, stdout()))
        return
    measured = measure_study(runs, duration, workers, say=_say)
    _give(measured, out, as_json, lambda: show_study(measured, stdout()))


def _give(document: Struct | dict[str, Any], out: Any, as_json: bool, show: Callable[[], None]) -> None:
    text = msgspec.json.format(msgspec.json.encode(document)).decode()
    if out is not None:
        out.write(text + "\n")
    if as_json:
        click.echo(text)
    else:
        show()


def _say(text: str) -> None:
    click.echo(text, err=True)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks")
