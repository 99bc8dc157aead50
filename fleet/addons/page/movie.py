"""A log as a movie: the pictures of `fleet view`, drawn one after the other into a GIF or an MP4 file."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

from matplotlib.animation import AbstractMovieWriter, FFMpegWriter
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from fleet.addons.page.log_feed import LogFeed
from fleet.addons.page.movie_scene import DRAWN_COLOURS, WIDTH_IN, MovieScene
from fleet.errors import FleetError
from netem.whole_file import whole_file

_GREYS = (0, 26, 52, 78, 104, 130, 150, 170, 188, 204, 217, 229, 240, 248, 255)
_TINTS = (1.0, 0.8, 0.63, 0.48, 0.34, 0.22, 0.12)  # shares of a colour on white


class GifWriter(AbstractMovieWriter):
    """Collects pictures, and writes them at the end; the same pictures give the same bytes."""

    def __init__(self, fps: int, colours: tuple[str, ...]) -> None:
        """Prepare it. `fps`: pictures per second, at most 50; a GIF counts in 10 ms. `colours`: of the drawing, on
        white. The palette has tints of each, and greys. At most 34."""
        super().__init__(fps=fps)
        self._pictures: list[Image.Image] = []
        parts = [grey for grey in _GREYS for _ in range(3)]
        for colour in colours:
            parts += [round(255 * (1 - share * (1 - part))) for share in _TINTS for part in to_rgb(colour)]
        self._palette = Image.new("P", (1, 1))
        self._palette.putpalette(parts)

    def setup(self, fig: Figure, outfile: Any, dpi: float | None = None) -> None:
        """Begin. Raises FileNotFoundError: there is no such directory."""
        super().setup(fig, outfile, dpi=dpi)
        self._pictures.clear()

    def grab_frame(self, **savefig_kwargs: Any) -> None:
        buffer = BytesIO()
        self.fig.savefig(buffer, format="rgba", dpi=self.dpi, **savefig_kwargs)
        picture = Image.frombytes("RGBA", self.frame_size, buffer.getvalue()).convert("RGB")
        self._pictures.append(picture.quantize(palette=self._palette, dither=Image.Dither.NONE))

    def finish(self) -> None:
        first, *others = self._pictures
        # With `optimize` it would look for the colours that are used, of the first picture.
        first.save(self.outfile, "gif", save_all=True, append_images=others, duration=round(100 / self.fps) * 10,
                   loop=0, optimize=False)  # fmt: skip


LASTS_S = 12.0  # by default, unless the log is shorter
MOST_BYTES = 1_000_000_000  # of the pictures of a GIF, which are all held until it is written
FORMATS = (".gif", ".mp4")


def write(
    log: Path,
    out: Path,
    on_progress: Callable[[float], None],
    *,
    view: str = "above",
    window: tuple[float, float | None] = (0.0, None),
    speed: float | None = None,
    fps: int = 10,
    width: int = 800,
) -> str:
    """Draw a log.

    Args:
        out: the file, `.gif`, or `.mp4` if ffmpeg is there. An existing file is replaced.
        on_progress: called with the share of the work that is done.
        view: `above` or `3d`.
        window: from when to when [s of simulated time]; None: the end of the log.
        speed: simulated seconds per second of the movie; None: so that it lasts LASTS_S, or 1 for what is shorter.
        fps: pictures per second.
        width: in pixels, a multiple of 8; the height is three quarters of it.

    Returns:
        what is missing of the log; empty: nothing.

    Raises:
        FleetError: the log has nothing to draw, or the file cannot be written; it holds no scenario of ours.
        LogReadError: the log cannot be read.
    """
    writer = _writer(out, fps)
    feed = LogFeed(log)
    begin_s, end_s = _window(feed, window)
    speed = speed or max(1.0, (end_s - begin_s) / LASTS_S)
    count = 1 + max(1, round((end_s - begin_s) / speed * fps))
    held = count * width * (width * 3 // 4)
    if isinstance(writer, GifWriter) and held > MOST_BYTES:
        raise FleetError(
            f"{count} pictures of this size take {held / 1e9:.1f} GB of memory, and {MOST_BYTES / 1e9:g} GB are "
            "allowed: choose a higher --speed, a lower --fps or --width, or write an .mp4"
        )
    of_all = {name: feed.signals.of_all(name) for name in feed.charted}
    charted = {name: (feed.signals.by_name[next(iter(of.values()))].unit, of) for name, of in of_all.items()}
    feed.follow([each for _, names in charted.values() for each in names.values()])
    verdict = feed.checks.get("verdict") if end_s >= feed.end_s else None
    scene = MovieScene(feed.picture, begin_s, end_s, speed, above=view == "above", verdict=verdict, charted=charted)
    try:
        with whole_file(out) as part:
            part.open("a").close()  # before the pictures, which take a while
            writer.setup(scene.figure, part, dpi=width / WIDTH_IN)
            _grab(
                writer,
                _draw_frames(feed, scene, begin_s, end_s, speed, fps, count),
                lambda k: on_progress((k + 1) / count),
            )
    except CalledProcessError as error:
        said = str(error.stderr).strip().splitlines() or [f"exit status {error.returncode}"]
        raise FleetError(f"ffmpeg could not write {out}: {said[-1]}") from None
    except OSError as error:
        raise FleetError(f"cannot write {out}: {error.strerror}; choose another place with -o FILE") from error
    return feed.missing or ""


def _grab(writer: GifWriter | FFMpegWriter, drawn: Iterator[int], on_progress: Callable[[int], None]) -> None:
    """Take each picture when it is drawn, and end the file. Raises CalledProcessError: ffmpeg failed."""
    try:
        for k in drawn:
            writer.grab_frame()
            on_progress(k)
    except BrokenPipeError:
        pass  # ffmpeg has ended, and says below why
    except BaseException:
        if isinstance(writer, FFMpegWriter):
            with suppress(CalledProcessError):
                writer.finish()
        raise
    writer.finish()


def _draw_frames(
    feed: LogFeed, scene: MovieScene, begin_s: float, end_s: float, speed: float, fps: int, count: int
) -> Iterator[int]:
    feed.seek(begin_s)
    scene.remember(feed.picture.history())
    for k in range(count):
        feed.forward(end_s if k == count - 1 else min(end_s, begin_s + k * speed / fps))
        scene.draw(feed.picture.frame(), k / fps)
        yield k


def _writer(out: Path, fps: int) -> GifWriter | FFMpegWriter:
    form = out.suffix.lower()
    if form not in FORMATS:
        raise FleetError(f"{out}: the name of a movie ends in {' or '.join(FORMATS)}")
    if form == ".gif":
        return GifWriter(fps, DRAWN_COLOURS)
    if not FFMpegWriter.isAvailable():
        raise FleetError("an .mp4 needs ffmpeg, which is not there: apt install ffmpeg, or write a .gif")
    logging.getLogger("matplotlib.animation").setLevel(logging.CRITICAL)  # what ffmpeg says is in our error
    return FFMpegWriter(fps=fps)


def _window(feed: LogFeed, window: tuple[float, float | None]) -> tuple[float, float]:
    if not feed.picture.setup()["placed"]:
        raise FleetError(
            f"{feed.path} does not tell where the vehicles are: its scenario has log: {{transforms: 0 ticks}}"
        )
    begin_s, end_s = window[0], feed.end_s if window[1] is None else window[1]
    if not 0.0 <= begin_s < end_s <= feed.end_s:
        raise FleetError(
            f"there is no time from {begin_s:g} s to {end_s:g} s in the log, which lasts from 0 s to {feed.end_s:g} s"
        )
    return begin_s, end_s
