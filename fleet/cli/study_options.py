"""Options of the commands that make many runs, as values with types, and what these commands print."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

import click

from fleet.cli.documents.output import json_option
from fleet.cli.types import FILE, FOLDER, FORCE, OVERRIDES, TRUST, Whole, disturbances, is_given
from fleet.study.spec import BoundarySpec, Kind, Spec, SpecField, StudySpec, fields
from fleet.terminal.status_line import BAR, StatusLine, bar
from fleet.terminal.table import Piece, TerminalColumn, say

if TYPE_CHECKING:
    from fleet.scenario.text.overrides import Override
    from fleet.study.engine import Engine
    from fleet.study.record import AxisRecord
    from fleet.study.store import Store
    from fleet.study.sweep import Progress

F = TypeVar("F", bound=Callable[..., Any])
S = TypeVar("S", StudySpec, BoundarySpec)
OUT = click.option("-o", "--out", type=FOLDER, default=Path("studies"), show_default=True,
                   help="The folder for studies; each gets a directory of its own.")  # fmt: skip
WORKERS = click.option("--workers", metavar="N", type=Whole(1, 1024), help="Runs at a time; by default one per core.")
SCHEDULER = click.option("--scheduler", metavar="ADDRESS", help="Use an existing Dask cluster, e.g. tls://host:8786.")
_LEAST = click.option("-o", "--out", type=FILE, help="The file for the smallest scenario; by default NAME-least.yaml.")


def least_options(command: F) -> F:
    """Add --out and --force of a scenario that is made less."""
    return _LEAST(FORCE(command))


@dataclass(frozen=True, slots=True)
class Making:
    """How a command makes its runs, and what it prints.

    Attributes:
        workers: of this machine; None: one per core.
        scheduler: address of a Dask cluster, to be used instead.
        quiet: show no progress.
    """

    workers: int | None
    scheduler: str | None
    quiet: bool

    def engine(self) -> AbstractContextManager[Engine]:
        """The workers that were asked for. Raises RunBroken or StudyError: they cannot be had."""
        from fleet.study.engine import engine_of

        return engine_of(self.workers, self.scheduler)

    @contextmanager
    def showing(self, pieces: Callable[..., list[Piece]]) -> Iterator[Callable[..., None]]:
        """A function that shows how the work goes; call it as often as you like.

        `pieces`: makes the status line of the line itself and of what the function is called with.
        """
        with StatusLine(quiet=self.quiet) as line:

            def tell(*what: object, **more: object) -> None:
                if line.due():
                    line.show(pieces(line, *what, **more))

            yield tell

    def warn(self, text: str) -> None:
        """Print a warning on stderr, unless it is to be quiet."""
        if not self.quiet:
            say(f"warning: {text}", err=True)


def making_options(quiet: str = "No progress.") -> Callable[[F], F]:
    """Add the options of `Making`, which the command gets as `how`; `quiet`: the help of that option."""

    def add(command: F) -> F:
        @wraps(command)
        def with_how(
            *arguments: Any, workers: int | None, scheduler: str | None, quiet: bool, **options: Any
        ) -> Any:  # fmt: skip
            return command(*arguments, how=Making(workers, scheduler, quiet), **options)

        made = click.option("-q", "--quiet", is_flag=True, help=quiet)(with_how)
        return WORKERS(SCHEDULER(TRUST(json_option(made))))  # type: ignore[return-value]

    return add


def changing_options(command: F) -> F:
    """Add --set, --net and --fault, which the command gets as `changes`."""

    @wraps(command)
    def with_changes(
        *arguments: Any, overrides: tuple[str, ...], fault: tuple[Override, ...], net: tuple[Override, ...],
        **options: Any,
    ) -> Any:  # fmt: skip
        return command(*arguments, changes=[*overrides, *net, *fault], **options)

    return OVERRIDES(disturbances(with_changes))  # type: ignore[return-value]


@dataclass(frozen=True, slots=True)
class Asked(Generic[S]):
    """What stands on the command line of a spec.

    Attributes:
        spec: the spec, with defaults where nothing is given.
        names: the fields that are given.
    """

    spec: S
    names: frozenset[str]

    @property
    def values(self) -> dict[str, Any]:
        """The values that are given."""
        return {name: getattr(self.spec, name) for name in self.names}


def spec_options(spec: type[S]) -> Callable[[F], F]:
    """Add an option for each field of a spec, which the command gets as `asked`.

    StudyError: a value that belongs to a key has none, or a key is there twice.
    """

    def add(command: F) -> F:
        known = fields(spec)
        names = [name for name, field in known.items() if field.flag is not None]
        taken = ["overrides" if name == "set" else name for name in names]

        @wraps(command)
        def with_asked(*arguments: Any, **options: Any) -> Any:
            found = _given(spec, {name: options.pop(name) for name in taken})
            needed: dict[str, Any] = {"scenario": ""} if "scenario" in known else {}
            asked = Asked(spec(**needed, **found), frozenset(found))
            return command(*arguments, asked=asked, **options)

        return _with_options(with_asked, spec)  # type: ignore[return-value]

    return add


def _with_options(command: F, spec: Spec) -> F:
    for field in reversed(fields(spec).values()):
        if field.kind is Kind.VALUE:  # of --set, which other commands have, too, as well as the next two
            command = OVERRIDES(disturbances(command))
        elif field.flag is not None and field.name not in ("net", "fault"):
            command = _click_option(field)(command)
    return command


def _given(spec: Spec, options: Mapping[str, Any]) -> dict[str, Any]:
    from fleet.study.given import set_values, varied

    found: dict[str, Any] = {}
    for name, field in fields(spec).items():
        parameter = "overrides" if field.kind is Kind.VALUE else name
        if field.flag is None or not is_given(parameter):
            continue
        value = options[parameter]
        if field.shape is dict:
            found[name] = set_values(value) if field.kind is Kind.VALUE else varied(value, field.flag)
        elif field.shape is list:
            found[name] = [item if isinstance(item, str) else item.text for item in value]
        else:
            found[name] = value
    return found


def study_directory(name: str, asked: Asked[Any]) -> Path | None:
    """The directory of the study that goes on; None: the name is that of something new.

    Raises click.UsageError: an option would change what the study runs.
    """
    from fleet.scenario.catalogue import shipped_scenarios
    from fleet.study.catalogue import shipped_studies

    if not Path(name).is_dir() or name in (*shipped_scenarios(), *shipped_studies()):
        return None
    known = fields(type(asked.spec))
    if is_given("out") or not all(known[key].option.later for key in asked.names):
        raise click.UsageError(f"{name} is a study with settings of its own: only its missing runs are made")
    return Path(name)


def _click_option(field: SpecField) -> Callable[[F], F]:
    about: dict[str, Any] = {"help": field.option.help, "metavar": field.option.metavar or field.kind.value}
    if field.shape is bool:
        about["is_flag"] = True
    elif field.shape in (list, dict):
        about |= {"multiple": True, "type": _Text(field) if field.shape is list else str}
    else:
        about |= {"type": _type(field), "default": field.default or None, "show_default": bool(field.default)}
    assert field.flag is not None  # else a file alone has it
    return click.option(field.flag, field.name, **about)


def _type(field: SpecField) -> click.ParamType[Any]:
    if field.shape is int:
        return Whole(*field.limits)
    if field.shape is float:
        return click.FLOAT
    return click.Choice(field.words) if field.shape is Literal else _Text(field)


class _Text(click.ParamType[str]):
    """A text of a field, checked as in a file."""

    def __init__(self, field: SpecField) -> None:
        self.name, self._field = field.name, field

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from fleet.study.errors import StudyError
        from fleet.study.given import read

        try:
            return str(read(self._field, value))
        except StudyError as error:
            self.fail(str(error), param, ctx)


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
    from fleet.study.summary import reached

    for one in reached(store):
        say(one.words if one.hits else f"{one.words}: that no check fails says little")
