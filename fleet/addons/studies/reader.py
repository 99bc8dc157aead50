"""The directory of a study, as commands take it in place of a log."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.addons.pictures.verbs.choice import DrawnData, PictureChoice
from fleet.errors import FleetError, printable
from fleet.terminal.progress import showing
from fleet.terminal.width import say

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fleet.addons.studies.store import Store


class StudyData(DrawnData):
    """The directory of a study."""

    name = "a study"

    def recognises(self, path: Path) -> bool:
        """Whether it is one."""
        return (path / "study.json").is_file()

    def plot(
        self,
        paths: Sequence[Path],
        out: Path | None,
        shown: PictureChoice,
        formats: Sequence[str],
        labels: Sequence[str | None],
        what: Sequence[str],
    ) -> Sequence[Path]:
        """Draw it, or several on the same axes. Raises StudyError: one is damaged, they vary other things, or there is
        no such measure; FleetError: the place is none."""
        from fleet.addons.studies.pictures.gallery import write

        stores, said = _open_all(paths, labels), list[str]()
        with showing("drawing") as on_progress:
            folder = out or paths[0] / "plots"
            drawn = write(stores, shown.measures, folder, formats, shown.log_scale, said.append, on_progress)
        for note in said:
            say(f"fleet: {note}", err=True)
        return drawn

    def figures(
        self,
        paths: Sequence[Path],
        out: Path | None,
        shown: PictureChoice,
        formats: Sequence[str],
        labels: Sequence[str | None],
        what: Sequence[str],
    ) -> dict[str, Figure]:
        """The pictures of `plot`. Raises as that does."""
        from fleet.addons.studies.pictures.gallery import plot

        return plot(_open_all(paths, labels), shown.measures, out, formats, shown.log_scale)

    def report(self, path: Path, out: Path, shown: PictureChoice) -> None:
        """Write the page about it. Raises as `plot`."""
        report_study(path, out, shown.measures, shown.log_scale)

    def export(self, path: Path, folder: Path, form: str, *, force: bool) -> Path:
        """Write its rows. Raises StudyError: it is damaged; FleetError: the place cannot be written."""
        if form == "netcdf":
            return super().export(path, folder, form, force=force)
        return export_study(path, folder, form, force=force)


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
    from fleet.addons.studies.engine_interface import require

    if form == "parquet":
        require(["pyarrow"], "Parquet needs", "parquet")
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


def _open_all(paths: Sequence[Path], labels: Sequence[str | None]) -> dict[str, Store]:
    """Studies by name: the given one, or what differs between their scenarios, or else the directory."""
    from fleet.addons.pictures.labels import differences, distinct
    from fleet.scenario.loading import parse_scenario

    stores = [_open(path) for path in paths]
    names = [store.record.scenario for store in stores]
    if len(set(names)) < len(names):
        names = [store.directory.resolve().name for store in stores]
        with suppress(FleetError):  # of another version; and a study without points has no scenario
            texts = [parse_scenario(store.points[0].scenario, store.record.scenario).to_yaml() for store in stores]
            different = differences(texts)
            names = different if len(set(different)) == len(names) else names
    called = distinct([label or printable(name) for label, name in zip(labels, names, strict=True)])
    return dict(zip(called, stores, strict=True))


def _open(directory: Path) -> Store:
    from fleet.addons.studies.engine_interface import require_extra

    require_extra()
    from fleet.addons.studies.store import Store

    return Store.open(directory)
