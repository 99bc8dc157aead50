"""Pictures, reports and tables of a study, for the commands that take a log or a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from fleet.terminal.status_line import showing
from fleet.terminal.table import say

if TYPE_CHECKING:
    from fleet.study.store import Store

measure_option = click.option("--measure", "measures", metavar="NAME", multiple=True,
                              help="For a study: another measure to show; repeatable. An unknown name lists "
                                   "them.")  # fmt: skip


def is_study(path: Path) -> bool:
    """Whether it is the directory of a study."""
    return (path / "study.json").is_file()


def check_options(subject: Path, options: Mapping[str, str], only_for: str) -> None:
    """Refuse options that were given, by their parameters, if they are for what the subject is not: UsageError."""
    source = click.get_current_context().get_parameter_source
    given = [option for name, option in options.items() if source(name) not in (None, ParameterSource.DEFAULT)]
    if given:
        raise click.UsageError(f"{', '.join(given)}: only for {only_for}; {subject} is none")


def plot_study(
    directory: Path, out: Path | None, measures: Sequence[str], formats: Sequence[str], log_scale: bool | None
) -> list[Path]:
    """Draw a study; returns the files, and tells what could not be drawn.

    Raises StudyError: it is damaged, there is no such measure, or the extra `study` is not installed; FleetError: the
    place cannot be written.
    """
    store = _open(directory)
    from fleet.study.pictures.gallery import write

    said: list[str] = []
    with showing("drawing") as tell:
        paths = write(store, measures, out or directory / "plots", formats, log_scale, said.append, tell)
    for note in said:
        say(f"fleet: {note}", err=True)
    return paths


def report_study(directory: Path, out: Path, measures: Sequence[str], log_scale: bool | None) -> None:
    """Write the page about a study.

    Raises StudyError: it is damaged, there is no such measure, or the extra `study` is not installed; FleetError: the
    place cannot be written.
    """
    store = _open(directory)
    from fleet.study.pictures.report import write

    with showing("drawing and adding up") as tell:
        write(out, store, measures, log_scale, tell)


def export_study(directory: Path, folder: Path, form: str, *, force: bool) -> Path:
    """Write the rows of a study as `csv` or `parquet`; returns the file.

    Raises StudyError: it is damaged, or an extra is not installed; FleetError: something is in the way, or the place
    cannot be written.
    """
    from fleet.errors import FleetError
    from fleet.study.engine import need

    if form == "parquet":
        need(["pyarrow"], "Parquet needs", "parquet")
    frame, path = _open(directory).frame(), folder / f"{directory.resolve().name}.{form}"
    if path.exists() and not force:
        raise FleetError(f"{path} is there already: choose another place, or replace it with --force")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if form == "parquet":
            frame.to_parquet(path, index=False)
        else:
            units = frame.attrs["units"]
            header = [f"{name} [{units[name]}]" if name in units else name for name in frame.columns]
            frame.to_csv(path, index=False, header=header)
    except OSError as error:
        raise FleetError(f"cannot write {path}: {error.strerror}; choose another place") from error
    return path


def _open(directory: Path) -> Store:
    from fleet.study.engine import need_extra

    need_extra()
    from fleet.study.store import Store

    return Store.open(directory)
