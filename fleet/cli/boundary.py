"""The command `fleet boundary`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from fleet.cli.completion import scenarios
from fleet.cli.documents.output import json_option, print_document
from fleet.cli.trust import TrustingCommand, trust_option
from fleet.cli.types import OVERRIDES, Duration, Whole, disturbances
from fleet.terminal.folding import say, stdout

if TYPE_CHECKING:
    from fleet.scenario.text.overrides import Override
    from fleet.study.borders import Border, Borders, Tell
    from fleet.study.modules import Modules
    from fleet.study.sweep import Progress
    from world.plugins.trust import Trust

OUTSIDE = ("below", "above")


@click.command(cls=TrustingCommand)
@click.argument("scenario", metavar="SCENARIO|DIR", shell_complete=scenarios)
@click.option("--along", metavar="KEY=LOW..HIGH", help="Along what the border is looked for.")
@click.option("--per", metavar="KEY=VALUES", multiple=True, help="One border for each of these values; repeatable.")
@click.option(
    "--level", metavar="RATE", type=float, default=0.5, show_default=True, help="The pass rate at the border."
)
@click.option("--width", metavar="SHARE", type=float, default=0.1, show_default=True,
              help="How wide the interval of a border may stay, as a share of the range.")  # fmt: skip
@click.option("--seeds", metavar="SEEDS", default="60", show_default=True,
              help="How many runs a border gets at most, each with its own seed, or those seeds.")  # fmt: skip
@OVERRIDES
@disturbances
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path, file_okay=False), default=Path("studies"),
              show_default=True, help="Where studies go, each in a directory of its own.")  # fmt: skip
@click.option("--workers", metavar="N", type=Whole(1, 1024), help="Runs at a time; by default one per core.")
@click.option("--scheduler", metavar="ADDRESS", help="Use a Dask cluster that is there, e.g. tls://host:8786.")
@click.option("--timeout", metavar="TIME", type=Duration(1), help="Wall time that one run may take, e.g. '5 min'.")
@trust_option
@json_option
def boundary(
    scenario: str,
    along: str | None,
    per: tuple[str, ...],
    level: float,
    width: float,
    seeds: str,
    overrides: tuple[str, ...],
    fault: tuple[Override, ...],
    net: tuple[Override, ...],
    out: Path,
    workers: int | None,
    scheduler: str | None,
    timeout: int | None,
    trust: Trust,
    as_json: bool,
) -> None:
    """Find where the pass rate of SCENARIO falls through a level, with few runs.

    Each run is made where its answer says most about the border, until the interval of 95 % is narrow. With the
    directory of such a study instead, go on where it was; border.png in it shows borders and runs.
    How often such intervals hold the border was measured, see docs/guide/studies.md: less than they say
    where even the best pass rate is far below 1.

    \b
    VALUES of --per are those of fleet sweep --vary. A name that is no key of the scenario fills {name} in
    --set, --net and --fault.

    \b
    Examples:
      fleet boundary rough-sea --along 'network.links.*.loss=0 %..95 %'
      fleet boundary paper --along 'loss=0 %..95 %' --per 'delay=0..2 s/9' --net '* loss {loss} delay {delay}'
      fleet boundary paper --along 'network.period=100 ms..5 s' --per profile=paper,hardened --level 0.9
      fleet boundary studies/paper-20261122-101500
    """
    from fleet.study.engine import need_extra

    need_extra()
    from fleet.scenario.catalogue import shipped_scenarios
    from fleet.scenario.text.overrides import SET, Override
    from fleet.study.border_theory import theory
    from fleet.study.borders import Borders, find_borders, parse_along, prepare_borders
    from fleet.study.errors import StudyError
    from fleet.study.local_engine import engine_of
    from fleet.study.pictures.border import write_borders
    from fleet.study.plan import Plan, parse_seeds
    from fleet.study.store import Store
    from fleet.study.study import new_directory
    from fleet.study.study_file import refuse_study
    from fleet.study.sweep import modules_again
    from fleet.study.values import parse_axis

    modules: Modules
    refuse_study(scenario)
    if Path(scenario).is_dir() and scenario not in shipped_scenarios():
        given = click.get_current_context().get_parameter_source
        said = [name for name in ("level", "width", "seeds", "out") if given(name) is not ParameterSource.DEFAULT]
        if along or per or overrides or fault or net or said:
            raise click.UsageError(f"{scenario} is a study: what it runs is settled; only the missing runs are made")
        borders = Borders(Store.open(Path(scenario)))
        modules = modules_again(borders.store, trust)
    elif along is None:
        raise click.UsageError("along what? give --along KEY=LOW..HIGH, such as 'network.links.*.loss=0 %..95 %'")
    else:
        changes = (*(Override(SET, text) for text in overrides), *net, *fault)
        axes = (*map(parse_axis, per), parse_along(along, width))
        plan = Plan(scenario, changes, axes, seeds=parse_seeds(seeds))
        store, modules = prepare_borders(plan, level, width, new_directory(scenario, out), trust)
        borders = Borders(store)
    directory = borders.store.directory
    if borders.open():
        most = len(borders.store.record.seeds)
        say(f"{directory}: borders: {borders.count}, each with {most} runs at most", err=True)
        with _showing() as tell, engine_of(workers, scheduler) as engine:
            try:
                find_borders(
                    borders, engine, tell, modules=modules, timeout_s=inf if timeout is None else timeout / 1e9
                )
            except KeyboardInterrupt:
                say(f"runs are missing; fleet boundary {directory} makes them", err=True)
                raise
    found = borders.found()
    if not as_json:
        _show(borders, found)
    picture = None
    try:
        picture = write_borders(borders, theory(borders, trust))
        say(str(picture), err=True)
    except StudyError as error:  # the answer is there without it
        say(f"there is no picture: {error}", err=True)
    if as_json:
        from fleet.cli.documents.boundary import boundary_document

        print_document(boundary_document(borders, found, None if picture is None else str(picture)))
    else:
        click.echo(directory)


@contextmanager
def _showing() -> Iterator[Tell]:
    """A function that shows how many borders are found; call it as often as you like."""
    from rich.console import Console as Terminal

    from fleet.cli.study_output import progress_pieces
    from fleet.terminal.fitting import Piece
    from fleet.terminal.status_line import StatusLine

    with StatusLine(Terminal(stderr=True), quiet=False) as line:

        def tell(progress: Progress, *, known: int, of: int) -> None:
            if not line.due():
                return
            of_all, shown = Piece(0, [f"{known} / {of} borders"]), Piece(2, [f"{progress.made} runs"])
            drawn, rate, failed = progress_pieces(line, known / of, progress)
            line.show([of_all, drawn, shown, rate, failed])

        yield tell


def _show(borders: Borders, found: list[Border]) -> None:
    """The table of the borders, and what is to be said of them."""
    from fleet.cli.study_output import axis_columns, cell
    from fleet.terminal.table import TerminalColumn, show

    along = borders.along
    unit = f" [{along.unit}]" if along.unit else ""
    columns = axis_columns(borders.store.record.axes[:-1], [row.values for row in found])
    name = along.key.removeprefix("network.links.")
    columns.append(TerminalColumn(f"border of\n{name}{unit}", [_border(row, borders) for row in found], 0))
    columns.append(TerminalColumn("95 %\ninterval", [_interval(row) for row in found], 0))
    columns.append(TerminalColumn("runs", [str(row.runs) for row in found], 1))
    if any(row.failed for row in found):
        columns.append(TerminalColumn("without\nresult", [str(row.failed) for row in found], 0))
    if any(row.where in OUTSIDE for row in found):
        columns.append(TerminalColumn("pass rate at\nthat end [%]", [_at_end(row) for row in found], 2))
    show(columns, borders.title, stdout(), "--json has all")
    for row in found:
        if row.rising is not None:
            where = ", ".join(f"{key}={cell(value)}" for key, value in row.values.items())
            low, high = row.rising
            say(f"{where + ': ' if where else ''}not one border: more runs pass at {high:g}{unit} and beyond than at "
                f"{low:g}{unit} and before; look with fleet sweep")  # fmt: skip


def _border(row: Border, borders: Borders) -> str:
    if row.where in OUTSIDE:
        return f"over {borders.places[-1]:g}" if row.where == "above" else f"under {borders.places[0]:g}"
    return f"{row.value:.3g}" if row.value == row.value else "?"


def _interval(row: Border) -> str:
    if row.where in OUTSIDE:
        return ""
    low, high = ("" if bound in (inf, -inf) else f"{bound:.3g}" for bound in (row.low, row.high))
    return f"{low}..{high}"


def _at_end(row: Border) -> str:
    if row.where not in OUTSIDE:
        return ""
    rate = row.last if row.where == "above" else row.first
    return f"{100 * rate.value:.0f}  {100 * rate.low:.0f}..{100 * rate.high:.0f}"


COMMANDS = (boundary,)
