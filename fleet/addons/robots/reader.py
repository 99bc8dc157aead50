"""Bags of ROS 2, as commands take them: the core reads them as logs, and here are their types, pictures and repair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.addons.pictures.verbs.choice import DrawnData, PictureChoice
from fleet.terminal.progress import showing

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mcap.records import Schema

    from fleet.mcap.other import MadeColumns, Recovered

_HEAD = b"\x89MCAP0\r\n\x01"  # of a file whose first record is its header; its length and profile follow
_PROFILE = b"\x04\x00\x00\x00ros2"


class RosBag(DrawnData):
    """The directory of a bag, or a file of one."""

    name = "a bag of ROS 2"
    is_log = True
    refused = ("vehicles", "measures")

    def recognises(self, path: Path) -> bool:
        """Whether it is the directory of a bag, or a file that says so."""
        if not path.is_dir():
            return path.suffix == ".mcap" and _is_of_ros(path)
        if (path / "run.mcap").exists():
            return False
        return (path / f"{path.resolve().name}.mcap").is_file() or any(map(_is_of_ros, sorted(path.glob("*.mcap"))[:1]))

    def columns(self, topic: str, encoding: str, schema: Schema, fields: frozenset[str] | None) -> MadeColumns | None:
        """What decodes messages of types that are known here."""
        if encoding != "cdr":
            return None
        from fleet.addons.robots.ros2.columns import ros_columns

        return ros_columns(topic, encoding, schema, fields)

    def plot(
        self,
        paths: Sequence[Path],
        out: Path | None,
        shown: PictureChoice,
        formats: Sequence[str],
        labels: Sequence[str | None],
        what: Sequence[str],
    ) -> Sequence[Path]:
        """Draw tracks, and numbers by topic. Raises FleetError: it cannot be read, there is no such topic, or the place
        cannot be written.
        """
        from fleet.addons.pictures.style import save_all
        from fleet.addons.robots.ros2.pictures import draw, load
        from fleet.terminal.width import say

        with showing("reading") as on_progress:
            bags = load(paths, labels, on_progress)
        said: list[str] = []
        with showing("drawing"):
            folder = out or (paths[0] if paths[0].is_dir() else paths[0].parent) / "plots"
            drawn = save_all(draw(bags, what, shown.window), folder, formats, said.append)
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
        """The pictures of `plot`."""
        from fleet.addons.pictures.style import figures
        from fleet.addons.robots.ros2.pictures import draw, load

        return figures(draw(load(paths, labels), what, shown.window), out, formats, lambda _: None)

    def report(self, path: Path, out: Path, shown: PictureChoice) -> None:
        """Write the page about it."""
        from fleet.addons.robots.ros2.pictures import write_report

        with showing("reading and drawing"):
            write_report(path, out, shown.window)

    def recover(self, path: Path, out: Path | None, on_progress: Callable[[float], None]) -> Recovered | None:
        """Write what is left, of a directory as a new bag. Raises LogReadError: it cannot be opened; FleetError: `out`
        cannot be written.
        """
        if not (path / f"{path.resolve().name}.mcap").is_file():
            return None  # of a split bag, its files
        from fleet.addons.robots.ros2.bag import repair

        return repair(path, out, on_progress)


def _is_of_ros(path: Path) -> bool:
    if not path.is_file():  # to open a pipe would wait for who writes it
        return False
    with path.open("rb") as file:
        head = file.read(len(_HEAD) + 8 + len(_PROFILE))
    return head.startswith(_HEAD) and head.endswith(_PROFILE)
