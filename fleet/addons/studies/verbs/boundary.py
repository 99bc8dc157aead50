"""The command `fleet boundary`."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from fleet.addons.pictures.verbs.choice import PictureFormats
from fleet.addons.studies.spec import BoundarySpec, seconds
from fleet.addons.studies.verbs.study_options import (
    MakingStudy,
    StudiesFolder,
    WorkerOptions,
    axis_columns,
    cell,
    progress_pieces,
    show_failing_stacks,
    show_reached,
    study_directory,
)
from fleet.cli.completion import scenarios
from fleet.cli.declare import command
from fleet.cli.documents.output import json_is_asked, print_document
from fleet.cli.types import is_given
from fleet.option import Option
from fleet.terminal.line import Piece
from fleet.terminal.status_line import StatusLine
from fleet.terminal.table import TerminalColumn, show
from fleet.terminal.width import say, stdout

if TYPE_CHECKING:
    from fleet.addons.studies.borders import Border, Borders
    from fleet.addons.studies.modules import Modules
    from fleet.addons.studies.sweep import Progress

OUTSIDE = ("below", "above")


@command(document="fleet.addons.studies.verbs.documents.BoundaryFound")
def boundary(
    scenario: Annotated[str, scenarios, Option("", "SCENARIO|DIR")],
    *,
    asked: BoundarySpec,
    out: StudiesFolder = Path("studies"),
    formats: Annotated[PictureFormats, Option("Of the picture: some of png, svg, pdf.", flag="--format")] = ("png",),
    how: MakingStudy,
) -> None:
    """Find where the pass rate of SCENARIO falls through a level, with few runs.

    Each run is placed where it tells most about the border, until the 95 % interval is narrow. With the directory of
    such a study, boundary continues it; border.png in it shows borders and runs. We measured how often such intervals
    contain the border (docs/guide/boundary.md): less often than 95 % if even the best pass rate is far below 1.

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
    from fleet.addons.studies.engine_interface import require_extra

    require_extra()
    borders, modules, timeout_s = _open_study(scenario, asked) or _prepare_study(scenario, asked, out, how)
    if borders.open():
        _run(borders, modules, timeout_s, how)
    found = borders.estimates()
    if not (json_is_asked() or how.quiet):
        _show(borders, found)
    picture = _picture(borders, modules, formats, how)
    if json_is_asked():
        from fleet.addons.studies.verbs.documents import boundary_document

        print_document(boundary_document(borders, found, None if picture is None else str(picture)))
    else:
        click.echo(borders.store.directory)


def _open_study(name: str, asked: BoundarySpec) -> tuple[Borders, Modules, float] | None:
    """The study of a directory, the modules that its runs need and the time that a run may take; None: it is none."""
    from fleet.addons.studies.borders import Borders
    from fleet.addons.studies.store import Store
    from fleet.addons.studies.study_file import refuse_study
    from fleet.addons.studies.sweep import modules_again

    refuse_study(name)
    if (directory := study_directory(name, asked)) is None:
        return None
    borders = Borders(Store.open(directory))
    timeout = asked.timeout if is_given("timeout") else borders.record.timeout
    return borders, modules_again(borders.store), seconds(timeout)


def _prepare_study(name: str, asked: BoundarySpec, out: Path, how: WorkerOptions) -> tuple[Borders, Modules, float]:
    from fleet.addons.studies.borders import Borders, border_plan, prepare_borders
    from fleet.addons.studies.study import new_directory

    if not asked.along:
        raise click.UsageError(
            "no key to search along: give --along KEY=LOW..HIGH, such as 'network.links.*.loss=0 %..95 %'"
        )
    store, modules = prepare_borders(border_plan(name, asked), asked, new_directory(name, out), how.warn)
    return Borders(store), modules, asked.timeout_s


def _run(borders: Borders, modules: Modules, timeout_s: float, how: WorkerOptions) -> None:
    from fleet.addons.studies.borders import find_borders

    directory, most = borders.store.directory, len(borders.store.record.seeds)
    if not how.quiet:
        say(f"{directory}: borders: {borders.count}, each with {most} runs at most", err=True)
    with how.showing(_pieces) as on_progress, how.engine(modules) as workers:
        try:
            find_borders(borders, workers, on_progress, modules=modules, timeout_s=timeout_s)
        except KeyboardInterrupt:
            say(f"runs are missing; fleet boundary {directory} makes them", err=True)
            raise


def _picture(borders: Borders, modules: Modules, formats: tuple[str, ...], how: WorkerOptions) -> Path | None:
    """Draw the borders; returns the first file, or None if that fails, with a message."""
    from fleet.addons.studies.borders import theory
    from fleet.addons.studies.errors import StudyError
    from fleet.addons.studies.pictures.border import write_borders
    from world.plugins.trust import Trust, trusting

    try:
        with trusting(Trust(fingerprints=frozenset(modules.fingerprints))):  # what the runs have run
            pictures = write_borders(borders, theory(borders), formats)
    except StudyError as error:  # the answer is there without it
        say(f"there is no picture: {error}", err=True)
        return None
    if not how.quiet:
        say("\n".join(map(str, pictures)), err=True)
    return pictures[0]


def _pieces(line: StatusLine, progress: Progress, *, known: int, of: int) -> list[Piece]:

    drawn, rate, failed = progress_pieces(line, known / of, progress)
    return [Piece(0, [f"{known} / {of} borders"]), drawn, Piece(2, [f"{progress.made} runs"]), rate, failed]


def _show(borders: Borders, found: list[Border]) -> None:

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
    show_reached(borders.store)
    show_failing_stacks(borders.store)
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
