"""The command `fleet plot`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import click

from fleet.addons.pictures.verbs.choice import (
    KINDS,
    OF_STUDIES,
    PARTS,
    PictureChoice,
    PictureFormats,
    PictureLabels,
    PicturesFolder,
    PictureWords,
    find_common_drawer,
    labels_by_name,
    pictures,
)
from fleet.cli.declare import command
from fleet.cli.log_argument import Log, check_options
from fleet.cli.types import (
    NoProgress,
)
from fleet.option import Option
from fleet.terminal.progress import showing
from fleet.terminal.width import say


@command()
def plot(
    log: Log,
    *,
    out: Annotated[Path | None, PicturesFolder(path_type=Path, file_okay=False), Option(
        "The folder for pictures; by default `plots` next to the log.", flag="-o --out")] = None,
    what: Annotated[tuple[str, ...], PictureWords(KINDS, "all", PARTS), pictures, Option(
        f"Some of {', '.join(KINDS)}; or all; track-3d, formation: that part of track, of error. Also any signal of "
        "the log: control.leads, command.tau_0, '|error.e|'.")] = KINDS,
    formats: Annotated[PictureFormats, Option("Some of png, svg, pdf.", flag="--format")] = ("png",),
    compare: Annotated[tuple[Path, ...], Option(
        "Another run, or another study, on the same axes; repeatable.", "LOG2")] = (),
    labels: Annotated[tuple[str, ...], PictureLabels(), Option(
        "The names in legends, in the order of the logs, or each by its directory: A=old,B=new. By default what "
        "differs.", "NAMES", "--label")] = (),
    caption: Annotated[bool, Option(
        "With --no-caption the words below each picture go into captions.txt.", flag="--caption/--no-caption")] = True,
    style: Annotated[str, Option(
        "The font, its size and the width of a column, e.g. font=serif,size=9pt,width=88mm.", "STYLE")] = "",
    shown: PictureChoice,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Draw pictures of LOG (an MCAP file, or a run directory), as wide as a column of a journal.

    The pictures are: tracks, consensus and formation errors with the limits of the checks, inputs with their limits,
    shares of packets by fate, messages in space and time, ages of information, the signals that the checks name, and
    any other signal. Faults are shaded. Prints the files.

    For the directory of a study it draws the pass rate and measures with intervals, as heat maps, curves or boxes,
    and differences in pairs of runs with the same seed. Hatched areas have runs without the number.

    For a bag of ROS 2 it draws tracks, and the numbers of each topic; --what takes track, /topic and /topic.field.

    \b
    Examples:
      fleet plot
      fleet plot --what error,inputs --format svg,pdf --linear
      fleet plot --what messages --window 20s..22s
      fleet plot --what state.z --vehicles 1,4
      fleet plot runs/a --compare runs/b --label old,new --what error -o compared
      fleet plot --no-caption --style font=serif,width=88mm --format pdf
      fleet plot studies/rough-sea-20261122-101500 --measure e_rms_m
    """
    from fleet.addons.pictures.labels import given_labels
    from fleet.addons.pictures.look import looking, parse_look

    look = replace(parse_look(style), caption=caption)
    paths = [log, *compare]
    other = find_common_drawer(paths)
    called = labels_by_name(labels)
    if other is not None:
        check_options(log, {*other.refused} & {*OF_STUDIES}, "studies")
        check_options(log, {*other.refused} - {*OF_STUDIES}, "logs of runs")
        with looking(look):
            _print(other.plot(paths, out, shown, formats, given_labels(paths, called), () if what == KINDS else what))
        return
    check_options(log, OF_STUDIES, "studies")
    from fleet.addons.pictures.gallery import check_signals, write
    from fleet.addons.pictures.runs import View, check_view, load
    from fleet.mcap.reader import log_path

    said: list[str] = []
    with showing("reading") as on_progress:
        runs = load(paths, on_progress, labels=called)
    view = View(shown.vehicles, shown.log_scale, shown.window)
    check_view(runs, view)
    check_signals(what, runs)
    with showing("drawing") as on_progress, looking(look):
        drawn = write(what, runs, view, out or log_path(log).parent / "plots", formats, said.append, on_progress)
    cut = [f"{run.label}: {run.log.missing}" for run in runs if run.log.missing]
    for note in dict.fromkeys([*cut, *(note for run in runs for note in run.notes), *said]):
        say(f"fleet: {note}", err=True)
    _print(drawn)


def _print(paths: Sequence[Path]) -> None:
    for path in paths:
        click.echo(path)
    if not paths:
        sys.exit(1)
