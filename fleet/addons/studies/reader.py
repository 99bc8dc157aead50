"""The directory of a study, as commands take it in place of a log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.addons.pictures.verbs.choice import DrawnData, PictureChoice
from fleet.errors import FleetError
from fleet.terminal.progress import showing
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.addons.studies.store import Store


class StudyData(DrawnData):
    """The directory of a study."""

    name = "a study"

    def recognises(self, path: Path) -> bool:
        """Whether it is one."""
        return (path / "study.json").is_file()

    def plot(self, path: Path, out: Path | None, shown: PictureChoice, formats: Sequence[str]) -> Sequence[Path]:
        """Draw it. Raises StudyError: it is damaged, or there is no such measure; FleetError: the place is none."""
        return plot_study(path, out, shown.measures, formats, shown.log_scale)

    def report(self, path: Path, out: Path, shown: PictureChoice) -> None:
        """Write the page about it. Raises as `plot`."""
        report_study(path, out, shown.measures, shown.log_scale)

    def export(self, path: Path, folder: Path, form: str, *, force: bool) -> Path:
        """Write its rows. Raises StudyError: it is damaged; FleetError: the place cannot be written."""
        if form == "netcdf":
            return super().export(path, folder, form, force=force)
        return export_study(path, folder, form, force=force)


def plot_study(
    directory: Path, out: Path | None, measures: Sequence[str], formats: Sequence[str], log_scale: bool | None
) -> list[Path]:
    """Draw a study; returns the files, and tells what could not be drawn.

    Raises StudyError: it is damaged, there is no such measure, or the extra `study` is not installed; FleetError: the
    place cannot be written.
    """
    store = _open(directory)
    from fleet.addons.studies.pictures.gallery import write

    said: list[str] = []
    with showing("drawing") as on_progress:
        paths = write(store, measures, out or directory / "plots", formats, log_scale, said.append, on_progress)
    for note in said:
        say(f"fleet: {note}", err=True)
    return paths


def report_study(directory: Path, out: Path, measures: Sequence[str], log_scale: bool | None) -> None:
    """Write the page about a study.

    Raises StudyError: it is damaged, there is no such measure, or the extra `study` is not installed; FleetError: the
    place cannot be written.
    """
    store = _open(directory)
    from fleet.addons.studies.pictures.report import write

    with showing("drawing and adding up") as on_progress:
        write(out, store, measures, log_scale, on_progress)


def export_study(directory: Path, folder: Path, form: str, *, force: bool) -> Path:
    """Write the rows of a study as `csv` or `parquet`; returns the file.

    Raises StudyError: it is damaged, or an extra is not installed; FleetError: something is in the way, or the place
    cannot be written.
    """
    from fleet.addons.studies.engine import need

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
    from fleet.addons.studies.engine import need_extra

    need_extra()
    from fleet.addons.studies.store import Store

    return Store.open(directory)
