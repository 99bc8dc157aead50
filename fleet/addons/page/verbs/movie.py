"""The command `fleet movie`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import click

from fleet.cli.declare import command
from fleet.cli.log_argument import Log
from fleet.cli.types import (
    FILE,
    TIME,
    Force,
    NoProgress,
    Whole,
)
from fleet.option import Option
from fleet.terminal.progress import showing
from fleet.terminal.width import say


@command()
def movie(
    log: Log,
    *,
    out: Annotated[Path, FILE, Option(
        "The movie: a .gif, or an .mp4 if ffmpeg is installed.", flag="-o --out")] = Path("movie.gif"),
    force: Force = False,
    view: Annotated[Literal["above", "3d"], Option("From where.")] = "above",
    begin: Annotated[int, TIME, Option("Begin at this time, e.g. 20s.", flag="--from")] = 0,
    end: Annotated[int | None, TIME, Option(
        "End at this time; by default at the end of the log.", flag="--to")] = None,
    speed: Annotated[float | None, click.FloatRange(0.001, 1000.0), Option(
        "Times real time; by default so that the movie lasts 12 s, but never slower than real time.", "X")] = None,
    fps: Annotated[int, Whole(1, 50), Option("Pictures per second.", "N")] = 10,
    width: Annotated[int, Whole(320, 1920), Option(
        "In pixels, rounded down to a multiple of 8; the height is three quarters of it.", "PX")] = 800,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Make a movie of LOG (an MCAP file, or a run directory) as fleet view shows it, as a GIF or an MP4.

    It shows hulls, their ways and desired places; links by their arrivals, packets, and faults with their remaining
    time. Below are the formation errors so far. The same log gives the same bytes of a GIF. Prints the file.

    \b
    Examples:
      fleet movie
      fleet movie runs/latest -o heal.gif --view 3d
      fleet movie runs/latest -o cut.mp4 --from 5s --to 40s --speed 2 --fps 25
    """
    from fleet.addons.page.movie import write
    from fleet.addons.pictures.page import check_place
    from fleet.mcap.reader import log_path

    check_place(out, force=force)
    window = begin / 1e9, None if end is None else end / 1e9
    with showing(f"drawing {out}") as on_progress:
        missing = write(
            log_path(log), out, on_progress, view=view, window=window, speed=speed, fps=fps, width=width - width % 8
        )
    if missing:
        say(f"fleet: {log}: {missing}", err=True)
    click.echo(out)
