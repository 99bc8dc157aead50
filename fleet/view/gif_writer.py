"""Pictures of matplotlib as a GIF of one palette: a third smaller than with a palette for each picture."""

from __future__ import annotations

from io import BytesIO
from typing import Any

from matplotlib.animation import AbstractMovieWriter
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

_GREYS = (0, 26, 52, 78, 104, 130, 150, 170, 188, 204, 217, 229, 240, 248, 255)
_TINTS = (1.0, 0.8, 0.63, 0.48, 0.34, 0.22, 0.12)  # shares of a colour on white


class GifWriter(AbstractMovieWriter):
    """Collects pictures, and writes them at the end; the same pictures give the same bytes."""

    def __init__(self, fps: int, colours: tuple[str, ...]) -> None:
        """Prepare it.

        Args:
            fps: pictures per second, at most 50; a GIF counts in 10 ms.
            colours: of the drawing, on white. The palette has tints of each, and greys. At most 34.
        """
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
        """Take the figure as it is now."""
        buffer = BytesIO()
        self.fig.savefig(buffer, format="rgba", dpi=self.dpi, **savefig_kwargs)
        picture = Image.frombytes("RGBA", self.frame_size, buffer.getvalue()).convert("RGB")
        self._pictures.append(picture.quantize(palette=self._palette, dither=Image.Dither.NONE))

    def finish(self) -> None:
        """Write the file."""
        first, *others = self._pictures
        # With `optimize` it would look for the colours that are used, of the first picture.
        first.save(self.outfile, "gif", save_all=True, append_images=others, duration=round(100 / self.fps) * 10,
                   loop=0, optimize=False)  # fmt: skip
