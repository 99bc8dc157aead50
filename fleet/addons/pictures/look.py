"""How a user wants pictures: the font, its size, the width of a column, and whether captions are in them.

Pictures are drawn within `looking`; what draws asks for sizes here. Without it they look as a column of a journal does.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any

import matplotlib
from matplotlib.font_manager import findfont, get_font_names

from fleet.errors import FleetError, printable
from netem.parsing import nearest

COLUMN_IN, PAGE_IN = 3.5, 7.0  # widths of a column and of a page of a journal
LABEL_PT, LEGEND_PT, TEXT_PT = 6.0, 7.0, 8.0  # names within a picture; legends and numbers; everything else
GENERIC = ("serif", "sans-serif", "monospace")
_IN = {"mm": 25.4, "cm": 2.54, "in": 1.0, "pt": 72.0}
_SIZES, _WIDTHS = (5.0, 20.0), (1.5, 14.0)  # pt; inches: outside them nothing can be read, or drawn
_KEYS = ("font", "size", "width")


@dataclass(frozen=True, slots=True)
class Look:
    """What a user may choose of the look of pictures."""

    font: str = ""  # "": that of matplotlib
    size_pt: float = TEXT_PT  # of most texts
    width_in: float = COLUMN_IN  # of a column; a page is twice as wide
    caption: bool = True  # words below a picture are in it


_AS_EVER = Look()
_wanted: ContextVar[Look] = ContextVar("look", default=_AS_EVER)


def current_look() -> Look:
    """The look that is wanted now."""
    return _wanted.get()


def text_pt() -> float:
    """The size of most texts."""
    return current_look().size_pt


def legend_pt() -> float:
    """The size of legends, numbers and captions."""
    return LEGEND_PT / TEXT_PT * current_look().size_pt


def label_pt() -> float:
    """The size of names within a picture."""
    return LABEL_PT / TEXT_PT * current_look().size_pt


def column_in() -> float:
    """The width of a column [inches]."""
    return current_look().width_in


def page_in() -> float:
    """The width of a page [inches]."""
    return PAGE_IN / COLUMN_IN * current_look().width_in


@contextmanager
def looking(look: Look) -> Iterator[None]:
    """Draw and write pictures with this look."""
    before = _wanted.set(look)
    try:
        with matplotlib.rc_context(_settings(look)):
            yield
    finally:
        _wanted.reset(before)


def _settings(look: Look) -> Any:
    if look == Look():
        return {}
    sizes = {"font.size": text_pt(), "axes.titlesize": text_pt(), "axes.labelsize": text_pt()}
    sizes |= dict.fromkeys(("legend.fontsize", "xtick.labelsize", "ytick.labelsize"), legend_pt())
    if not look.font:
        return sizes
    with_serifs = look.font == "serif" or "times" in look.font.lower() or "serif" in look.font.lower().split()
    # What the font does not have, such as a cross, comes from the usual one.
    return sizes | {
        "font.family": [look.font, "DejaVu Sans"],
        "mathtext.fontset": "stix" if with_serifs else "dejavusans",
    }


def parse_look(text: str) -> Look:
    """A look in words, such as `font=serif,size=9pt,width=88mm`. Raises FleetError: it is none."""
    look = Look()
    for part in filter(None, map(str.strip, text.split(","))):
        key, equals, value = (word.strip() for word in part.partition("="))
        if not equals or key not in _KEYS or not value:
            hint = nearest(key, _KEYS) or "there are font, size and width"
            raise FleetError(f"style: {printable(part)!r} is unknown; {hint}; write font=serif,size=9pt,width=88mm")
        if key == "font":
            look = replace(look, font=_font(value))
        elif key == "size":
            look = replace(look, size_pt=72.0 * _length(key, value, "pt", tuple(one / 72.0 for one in _SIZES)))
        else:
            look = replace(look, width_in=_length(key, value, "mm", _WIDTHS))
    return look


def _font(name: str) -> str:
    if name in GENERIC:
        return name
    try:
        findfont(name, fallback_to_default=False)
    except ValueError:
        known = [*GENERIC, *get_font_names()]
        hint = nearest(name, known) or f"there are {', '.join(known[:8])} and {len(known) - 8} more"
        raise FleetError(f"style: no font {printable(name)!r} is installed; {hint}") from None
    return name


def _length(key: str, text: str, unit: str, limits: tuple[float, ...]) -> float:
    """A length [inches]."""
    found = re.fullmatch(r"(\d{1,4}(?:\.\d{1,4})?)\s*(mm|cm|in|pt)?", text)
    least, most = limits
    inches = float(found[1]) / _IN[found[2] or unit] if found is not None else 0.0
    if not least <= inches <= most:
        span = f"{least * _IN[unit]:g} to {most * _IN[unit]:g} {unit}"
        raise FleetError(f"style: {key}: expected {span}, in mm, cm, in or pt, got {printable(text)!r}")
    return inches
