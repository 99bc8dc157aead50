"""Options of the commands that make many runs, as values with types, and what these commands print."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click
from click.shell_completion import CompletionItem

from fleet.addons.studies.spec import BoundarySpec, StudySpec
from fleet.cli.completion import names_or_files
from fleet.cli.types import FILE, FOLDER, Trust, Whole, is_given
from fleet.option import Option, fields
from fleet.terminal.line import Piece
from fleet.terminal.status_line import BAR, StatusLine, bar
from fleet.terminal.table import TerminalColumn
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.addons.studies.engine_interface import Engine
    from fleet.addons.studies.modules import Modules
    from fleet.addons.studies.record import AxisRecord
    from fleet.addons.studies.store import Store
    from fleet.addons.studies.sweep import Progress


def studies(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete shipped studies and scenarios; without one, files."""
    from fleet.addons.studies.catalogue import shipped_studies
    from fleet.scenario.catalogue import shipped_scenarios

    return names_or_files([*shipped_studies(), *shipped_scenarios()], typed)


StudiesFolder = Annotated[
    Path, FOLDER, Option("The folder for studies; each gets a directory of its own.", flag="-o --out")
]
LeastFile = Annotated[
    Path | None, FILE, Option("The file for the smallest scenario; by default NAME-least.yaml.", flag="-o --out")
]


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """How a command makes its runs, and what it prints: the options of all commands that make many."""

    workers: Annotated[int | None, Whole(1, 1024), Option("Runs at a time; by default one per core.", "N")] = None
    scheduler: Annotated[str | None, Option("Use an existing Dask cluster, e.g. tls://host:8786.", "ADDRESS")] = None
    trust: Trust = False
    quiet: Annotated[bool, Option("No progress.", flag="-q --quiet")] = False

    def engine(self, modules: Modules) -> AbstractContextManager[Engine]:
        """The workers that were asked for, of runs that need these modules. Raises RunBroken or StudyError: they cannot
        be had.
        """
        from fleet.addons.studies.engine import engine_of

        return engine_of(modules, self.workers, self.scheduler, self.warn)

    @contextmanager
    def showing(self, pieces: Callable[..., list[Piece]]) -> Iterator[Callable[..., None]]:
        """A function that shows how the work goes; call it as often as you like.

        `pieces`: makes the status line of the line itself and of what the function is called with.
        """
        with StatusLine(quiet=self.quiet) as line:

            def on_progress(*what: object, **more: object) -> None:
                if line.due():
                    line.show(pieces(line, *what, **more))

            yield on_progress

    def warn(self, text: str) -> None:
        """Print a warning on stderr, unless it is to be quiet."""
        if not self.quiet:
            say(f"warning: {text}", err=True)


@dataclass(frozen=True, slots=True)
class MakingStudy(WorkerOptions):
    """The same of a command that makes a study."""

    quiet: Annotated[bool, Option("Print only the study's directory; failures go to stderr.", flag="-q --quiet")] = (
        False
    )


def given_values(spec: StudySpec | BoundarySpec) -> dict[str, Any]:
    """The values of a spec that stand on the command line, by field."""
    known = fields(type(spec)).values()
    return {each.name: getattr(spec, each.name) for each in known if each.flag is not None and is_given(each.name)}


def study_directory(name: str, asked: StudySpec | BoundarySpec) -> Path | None:
    """The directory of the study that goes on; None: the name is that of something new.

    Raises click.UsageError: an option would change what the study runs.
    """
    from fleet.addons.studies.catalogue import shipped_studies
    from fleet.scenario.catalogue import shipped_scenarios

    if not Path(name).is_dir() or name in (*shipped_scenarios(), *shipped_studies()):
        return None
    known = fields(type(asked))
    if is_given("out") or not all(known[key].option.later for key in given_values(asked)):
        raise click.UsageError(f"{name} is a study with settings of its own: only its missing runs are made")
    return Path(name)


def axis_columns(axes: Sequence[AxisRecord], rows: Sequence[Mapping[str, float | str]]) -> list[TerminalColumn]:
    """A column for each key that is varied. `rows`: the values of each row of the table by key."""
    columns = []
    for axis in axes:
        heading = axis.key.removeprefix("network.links.") + (f"\n[{axis.unit}]" if axis.unit else "")
        cells = [cell(values[axis.key]) for values in rows]
        columns.append(TerminalColumn(heading, cells, 0, "left" if axis.unit is None else "right"))
    return columns


def cell(value: float | str) -> str:
    """A value of a key that is varied."""
    return value if isinstance(value, str) else f"{value:g}"


def progress_pieces(line: StatusLine, share: float, progress: Progress) -> list[Piece]:
    """How far it is, how fast it goes, and how many runs have no result."""
    rate = f"{progress.rate:.2g} {progress.doing}/s" if progress.new else ""
    failed = f"{progress.failed} without result" if progress.failed else ""
    return [
        Piece(5, [bar(share), bar(share, BAR // 2), ""] if line.live else [""]),
        Piece(3, [rate, ""]),
        Piece(1, [failed, ""]),
    ]


def show_reached(store: Store) -> None:
    """Say what some run had to reach, and whether one did."""
    from fleet.addons.studies.summary import sometimes_reached

    for one in sometimes_reached(store):
        say(one.words if one.hits else f"{one.words}: that no check fails says little")


def show_failing_stacks(store: Store, most: int = 2) -> None:
    """Say how the first runs of programs failed whose directories the study has kept, and how to make them again."""
    from fleet.addons.studies.stack_runs import describe_failure

    if not store.record.programs:
        return
    failed = [(row, store.log_of(row.point, row.seed)) for row in store.rows() if row.passed is False]
    kept = [(row, place) for row, place in failed if place.exists()]
    for row, place in kept[:most]:
        values = store.points[row.point].values.items()
        where = ", ".join(f"{key.removeprefix('network.links.')}={cell(value)}" for key, value in values)
        say("\n".join([f"seed {row.seed} failed{f' at {where}' if where else ''}", *describe_failure(place)]))
    if len(kept) > most:
        say(f"{len(kept) - most} more runs that failed are in {store.logs}")
