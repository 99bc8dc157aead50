"""The words below a picture, in lines that fit; a user may have them beside the file instead."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from fleet.addons.pictures.look import current_look, legend_pt

_EDGE_PT = 4.0
_DPI = 300.0  # fewer would round the widths of letters
_LINE = 1.25  # times the size of the font, from line to line


def write_caption(figure: Figure, lines: Sequence[str]) -> None:
    """Put lines below a figure, which gets higher by them. They are left out if the user wants so: `caption_of` has
    them in any case.
    """
    figure.set_label("\n".join(lines))
    if not lines or not current_look().caption:
        return
    width, height = figure.get_size_inches()
    room = 72.0 * width - 2.0 * _EDGE_PT
    shown = [part for line in lines for part in fitting(line, room, legend_pt())]
    figure.set_size_inches(width, height + (_LINE * len(shown) * legend_pt() + 2.0) / 72.0)
    figure.supxlabel(
        "\n".join(shown), x=_EDGE_PT / (72.0 * width), ha="left", fontsize=legend_pt(), multialignment="left",
        linespacing=_LINE,
        parse_math=False,
    )  # fmt: skip


def caption_of(figure: Figure) -> str:
    """The lines below a figure, whether they are shown or not."""
    return str(figure.get_label())


def fitting(line: str, room_pt: float, size_pt: float) -> Iterator[str]:
    """A line of text as lines that are no wider than some room, broken at blanks as far as there are some."""
    found = ""
    for word in line.split(" "):
        longer = f"{found} {word}" if found else word
        if found and text_width_pt(longer, size_pt) > room_pt:
            yield found
            longer = word
        while text_width_pt(longer, size_pt) > room_pt and len(longer) > 1:
            shorter = range(len(longer) - 1, 1, -1)
            cut = next((k for k in shorter if text_width_pt(longer[:k], size_pt) <= room_pt), 1)
            yield longer[:cut]
            longer = longer[cut:]
        found = longer
    yield found


def text_width_pt(text: str, size: float) -> float:
    """The width of a text [pt] in the font of the pictures."""
    width, _, _ = _renderer().get_text_width_height_descent(text, FontProperties(size=size), False)
    return float(width) * 72.0 / _DPI


@cache
def _renderer() -> Any:
    return RendererAgg(1, 1, _DPI)  # type: ignore[no-untyped-call]
