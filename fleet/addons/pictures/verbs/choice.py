"""What pictures of a log, or of something like it, show: options that several commands have."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import click
from click.shell_completion import CompletionItem

from fleet.cli.completion import RUNS, quote_for_shell
from fleet.cli.types import (
    VEHICLES,
    WINDOW,
    Folder,
    Words,
)
from fleet.errors import FleetError
from fleet.mcap.other import OtherData, find_other_data
from fleet.option import Option

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("track", "error", "inputs", "links", "messages", "channel", "ages", "checks", "timing")
PARTS = ("track-3d", "formation")  # single pictures of track and error
FORMATS = ("png", "svg", "pdf")
OTHER_FORMATS = ("bmp", "eps", "gif", "jpeg", "jpg", "ps", "tif", "tiff", "webp")  # of pictures, which are not written
OF_LOGS = ("what", "vehicles", "window")
OF_STUDIES = ("measures",)


@dataclass(frozen=True, slots=True)
class PictureChoice:
    """What pictures of a log, or of a study, show."""

    measures: Annotated[tuple[str, ...], Option(
        "For a study: another measure to show; repeatable. An unknown name lists them.", "NAME",
        "--measure")] = ()  # fmt: skip
    vehicles: Annotated[tuple[int, ...] | None, VEHICLES, Option("Only these, e.g. 1,3-5.")] = None
    log_scale: Annotated[bool | None, Option(
        "Errors, other signals and ages on a logarithmic axis, or all on a linear one. By default errors are "
        "logarithmic, and a study's measures that span much.", flag="--log-scale/--linear")] = None  # fmt: skip
    window: Annotated[tuple[float, float] | None, WINDOW, Option(
        "Only this time, e.g. 20s..40s. By default `messages` and `channel` show some rounds, and the other pictures "
        "the whole run.")] = None  # fmt: skip


PictureFormats = Annotated[tuple[str, ...], Words(FORMATS)]


class PicturesFolder(Folder):
    """A folder for pictures; refused is what looks like a picture's file."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        folder = Path(super().convert(value, param, ctx))  # type: ignore[arg-type]
        if folder.suffix.lower()[1:] in (*FORMATS, *OTHER_FORMATS) and not folder.is_dir():
            self.fail(
                f"expected a folder, because there are several pictures, got {str(folder)!r}; choose their format with "
                f"--format: {', '.join(FORMATS)}",
                param,
                ctx,
            )
        return folder


class PictureLabels(click.ParamType[tuple[str, ...]]):
    """Names with commas between them, each alone, or behind what it names: `A=old,B=new`."""

    name = "names"

    def write(self, value: tuple[str, ...]) -> str:
        """The text of a default."""
        return ",".join(value)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        names = tuple(word.strip() for word in str(value).split(","))
        if not all(word.rpartition("=")[2].strip() for word in names):
            self.fail(f"expected names such as old,new or A=old,B=new, got {value!r}", param, ctx)
        if len({"=" in word for word in names}) > 1:
            self.fail(f"expected all names alone or each behind what it names, got {value!r}", param, ctx)
        return names


def labels_by_name(labels: Sequence[str]) -> dict[str, str] | Sequence[str]:
    """The same by what each names, if they say that."""
    if not all("=" in label for label in labels):
        return labels
    split = [label.rpartition("=") for label in labels]
    return {key.strip(): label.strip() for key, _, label in split}


class PictureWords(Words):
    """Some of the given words, or signals such as `control.leads`; whether a log has such a signal is not known yet."""

    others = ", signals such as control.leads, and topics of a bag such as /odom"

    def allows(self, word: str) -> bool:
        """Whether it has the form of a signal's name."""
        from fleet.scenario.sections.signals import parse_name

        return parse_name(word) is not None or word.startswith("/")  # of a bag


def pictures(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete the last word of a list of pictures, also with the signals of the log."""
    before, comma, last = typed.rpartition(",")
    words = [*getattr(parameter.type, "words", ())]
    try:
        from fleet.execution.past_runs import newest_run
        from fleet.logs.topic_names import signal_names

        # Where the option has no value yet, click has not told the arguments apart.
        log = context.params.get("log") or next(iter(context.args), None)
        words += signal_names(Path(log) if log else newest_run(RUNS) or RUNS)
    except Exception:
        words = words[:]  # no log, or none that can be read: the words alone
    return [CompletionItem(quote_for_shell(before + comma + word)) for word in words if word.startswith(last)]


class DrawnData(OtherData):
    """Something besides a log of a run that `fleet plot` and `fleet report` can draw.

    Attributes:
        refused: options, by their parameters, that mean nothing for it.
    """

    refused: ClassVar[tuple[str, ...]] = OF_LOGS

    @abstractmethod
    def plot(
        self,
        paths: Sequence[Path],
        out: Path | None,
        shown: PictureChoice,
        formats: Sequence[str],
        labels: Sequence[str | None],
        what: Sequence[str],
    ) -> Sequence[Path]:
        """Draw it, or several on the same axes, and tell what could not be drawn.

        Args:
            paths: what the user named.
            out: the folder for pictures; None: `plots` in or beside the first.
            shown: what they show.
            formats: some of `FORMATS`.
            labels: how the user calls each; None: as this kind of data is called.
            what: which pictures; empty: all.

        Returns:
            The files.

        Raises:
            FleetError: one cannot be read, they are not alike, or the place cannot be written.
        """

    @abstractmethod
    def figures(
        self,
        paths: Sequence[Path],
        out: Path | None,
        shown: PictureChoice,
        formats: Sequence[str],
        labels: Sequence[str | None],
        what: Sequence[str],
    ) -> dict[str, Figure]:
        """The pictures of `plot` by name, for scripts: nothing is told. `out`: None: no file is written."""

    @abstractmethod
    def report(self, path: Path, out: Path, shown: PictureChoice) -> None:
        """Write the page `out` about it. Raises FleetError as `plot` does."""


def find_drawer(path: Path) -> DrawnData | None:
    """The part that draws what lies there, such as a study or a bag. None: nobody draws it, or it is a log of a run."""
    found = find_other_data(path)
    return found if isinstance(found, DrawnData) else None


def find_common_drawer(paths: Sequence[Path]) -> DrawnData | None:
    """What draws all of these; None: they are logs. Raises FleetError: they are not of one kind."""
    kinds = [find_drawer(path) for path in paths]
    if len({type(kind) for kind in kinds}) > 1:
        one, other = (next(k for k, kind in enumerate(kinds) if (kind is None) == log) for log in (False, True))
        name = kinds[one].name  # type: ignore[union-attr]
        raise FleetError(f"{paths[one]} is {name}, and {paths[other]} a log: compare two of a kind")
    return kinds[0]
