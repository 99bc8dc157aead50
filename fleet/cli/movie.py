"""The command `fleet movie`."""

from __future__ import annotations

from pathlib import Path

import click

from fleet.cli.log_argument import log_argument
from fleet.cli.types import Duration, Whole


@click.command()
@log_argument
@click.option(
    "-o", "--out", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False), default=Path("movie.gif"),
    show_default=True, help="The movie: a .gif, or an .mp4 if ffmpeg is installed.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Replace what is there.")
@click.option("--view", type=click.Choice(["above", "3d"]), default="above", show_default=True, help="From where.")
@click.option("--from", "begin", metavar="TIME", type=Duration(), default="0s", help="Begin at this time, e.g. 20s.")
@click.option(
    "--to", "end", metavar="TIME", type=Duration(), help="End at this time; by default at the end of the log."
)
@click.option(
    "-r", "--rate", metavar="X", type=click.FloatRange(0.001, 1000.0),
    help="Times real time; by default so that the movie lasts 12 s, but never slower than real time.",
)  # fmt: skip
@click.option("--fps", metavar="N", type=Whole(1, 50), default=10, show_default=True,
              help="Pictures per second.")  # fmt: skip
@click.option(
    "--width", metavar="PX", type=Whole(320, 1920), default=800, show_default=True,
    help="In pixels, rounded down to a multiple of 8; the height is three quarters of it.",
)  # fmt: skip
def movie(
    log: Path,
    out: Path,
    force: bool,
    view: str,
    begin: int,
    end: int | None,
    rate: float | None,
    fps: int,
    width: int,
) -> None:
    """Make a movie of LOG (an MCAP file, or a run directory) as fleet view shows it, as a GIF or an MP4.

    It shows hulls, their ways and desired places; links by their arrivals, packets, and faults with their remaining
    time. Below are the formation errors so far. The same log gives the same bytes of a GIF. Prints the file.

    \b
    Examples:
      fleet movie
      fleet movie runs/latest -o heal.gif --view 3d
      fleet movie runs/latest -o cut.mp4 --from 5s --to 40s --rate 2 --fps 25
    """
    from fleet.logs.reader import log_path
    from fleet.pictures.page import check_place
    from fleet.terminal.status_line import showing
    from fleet.terminal.table import say
    from fleet.view.movie import write

    check_place(out, force=force)
    window = begin / 1e9, None if end is None else end / 1e9
    with showing(f"drawing {out}") as tell:
        missing = write(log_path(log), out, tell, view=view, window=window, rate=rate, fps=fps, width=width - width % 8)
    if missing:
        say(f"fleet: {log}: {missing}", err=True)
    click.echo(out)


COMMANDS = (movie,)
