"""Options of the commands that make many runs: the options that a spec declares, and those that the commands share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

import click

from fleet.cli.types import FORCE, OVERRIDES, Whole, disturbances, is_given
from fleet.study.spec import Kind, Spec, SpecField, fields
from fleet.terminal.table import say

F = TypeVar("F", bound=Callable[..., Any])
OUT = click.option("--out", metavar="DIR", type=click.Path(path_type=Path, file_okay=False), default=Path("studies"),
                   show_default=True, help="The folder for studies; each gets a directory of its own.")  # fmt: skip
WORKERS = click.option("--workers", metavar="N", type=Whole(1, 1024), help="Runs at a time; by default one per core.")
SCHEDULER = click.option("--scheduler", metavar="ADDRESS", help="Use an existing Dask cluster, e.g. tls://host:8786.")
_LEAST = click.option("-o", "--out", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False),
                      help="The file for the smallest scenario; by default NAME-least.yaml.")  # fmt: skip


def least_options(command: F) -> F:
    """Add --out and --force of a scenario that is made less."""
    return _LEAST(FORCE(command))


def spec_options(spec: Spec) -> Callable[[F], F]:
    """Add an option for each field of a spec; `given` reads what a command gets for them."""

    def add(command: F) -> F:
        for field in reversed(fields(spec).values()):
            if field.kind is Kind.VALUE:  # of --set, which other commands have, too, as well as the next two
                command = OVERRIDES(disturbances(command))
            elif field.flag is not None and field.name not in ("net", "fault"):
                command = _click_option(field)(command)
        return command

    return add


def given(spec: Spec, options: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a spec that stand on the command line.

    Args:
        options: of the command, as `spec_options` added them.

    Raises:
        StudyError: a value that belongs to a key has none, or a key is there twice.
    """
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


def study_directory(name: str, spec: Spec, asked: Mapping[str, Any]) -> Path | None:
    """The directory of the study that goes on; None: the name is that of something new.

    Args:
        asked: what stands on the command line, see `given`.

    Raises:
        click.UsageError: an option would change what the study runs.
    """
    from fleet.scenario.catalogue import shipped_scenarios
    from fleet.study.catalogue import shipped_studies

    if not Path(name).is_dir() or name in (*shipped_scenarios(), *shipped_studies()):
        return None
    known = fields(spec)
    if is_given("out") or not all(known[key].option.later for key in asked):
        raise click.UsageError(f"{name} is a study with settings of its own: only its missing runs are made")
    return Path(name)


def warning(*, quiet: bool = False) -> Callable[[str], None]:
    """A function that prints a warning on stderr; if quiet, it prints none."""
    return lambda text: None if quiet else say(f"warning: {text}", err=True)


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
