"""Curves with bands: a number and its interval over what is varied, one line for each word."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator, ScalarFormatter

from fleet.addons.pictures.caption import write_caption
from fleet.addons.pictures.look import column_in, page_in
from fleet.addons.pictures.style import STYLES, limit, panels, plain_decades
from fleet.addons.studies.pictures.marks import (
    BAND,
    Lacks,
    Layout,
    Panel,
    axis_label,
    columns_of,
    estimate_words,
    has_interval,
    interval_label,
    legend,
    logarithmic,
    quantity_label,
    room,
    scale,
    text,
    used_axes,
)
from fleet.addons.studies.pictures.points import (
    Cell,
    Quantity,
    Value,
    value_words,
)
from fleet.mcap.records import Array
from fleet.palette import COLOURS

_MARKERS = "osD^vP*"
_MOST_BARS = 12  # places with a point and a bar each; more are joined by a line with a band
_STRIP = 0.07  # height of the hatched strip of a line, of the axis


def curves(quantity: Quantity, layout: Layout, shown: Sequence[Panel], log_scale: bool | None) -> Figure:
    """Draw some panels of a layout with one axis; intervals are bands, of many lines bars side by side."""
    drawn = _Curves(quantity, layout)
    columns = columns_of(len(shown))
    rows = -(-len(shown) // columns)
    figure, axes = panels(rows, columns, column_in() if columns == 1 else page_in(), 2.1 * rows + 0.2, share=False)
    for k, ax, panel in used_axes(axes, shown):
        if quantity.kind == "difference":
            limit(ax, 0.0)
        strips = 0
        for number in range(len(drawn.names)):
            strips += drawn.line(ax, panel, number, strips)
        drawn.scales(ax, strips, log_scale)
        if k % columns == 0:
            ax.set_ylabel(quantity_label(quantity))
        if k + columns >= len(shown):
            ax.set_xlabel(axis_label(drawn.along))
    drawn.lacks.draw(lambda ax: ax.get_xaxis_transform())
    legend(figure, drawn.handles())
    write_caption(figure, [estimate_words(quantity)])
    return figure


class _Curves:
    def __init__(self, quantity: Quantity, layout: Layout) -> None:
        (self._x,) = layout.axes
        self._quantity, self._layout = quantity, layout
        self.along = layout.dimensions[self._x]
        self.names: tuple[Value | None, ...] = (None,)
        if layout.lines is not None:
            self.names = layout.dimensions[layout.lines].values
        self.lacks = Lacks()
        self._places = np.array(self.along.values, float)
        self._logs = logarithmic(self._places.tolist())
        self._edges = _edges(self._places, self._logs)
        self._bars = len(self._places) <= _MOST_BARS

    def line(self, ax: Axes, panel: Panel, number: int, strip: int) -> bool:
        """Draw one line with its intervals; returns whether some of its runs lack the number, hatched in a strip."""
        name, lines = self.names[number], self._layout.lines
        fixed = {} if name is None or lines is None else {lines: name}
        keys = (self._layout.key(panel, fixed | {self._x: value}) for value in self.along.values)
        cells = [self._quantity.cells.get(key) for key in keys]
        found, colour = self._estimates(cells), COLOURS[number]
        where = self._places
        if self._bars:
            where = _spread_places(self._places, (number + 0.5) / len(self.names), self._logs)
            ax.vlines(where, found[:, 1], found[:, 2], color=colour, linewidth=1.2, gid="band")
        else:
            ax.fill_between(where, found[:, 1], found[:, 2], color=colour, alpha=BAND, linewidth=0, gid="band")
        ax.plot(where, found[:, 0], color=colour, linestyle=self._style(number), marker=_MARKERS[number],
                markersize=3.0 if len(self._places) < 40 else 1.5, gid="curve")  # fmt: skip
        return self._hatched(ax, cells, strip, colour)

    def _style(self, number: int) -> Any:
        return "none" if self._bars else STYLES[number]

    def _estimates(self, cells: Sequence[Cell | None]) -> Array:
        """Value and interval at each place; NaN where there is none, and no end of an interval is infinite."""
        there = [cell.estimate if cell is not None else (np.nan,) * 3 for cell in cells]
        found: Array = scale(self._quantity) * np.array([each[:3] for each in there], float)
        highest = found[np.isfinite(found)].max(initial=-np.inf)
        found[:, 2][np.isposinf(found[:, 2])] = highest  # half of the runs or more may lack the number
        found[~np.isfinite(found)] = np.nan
        return found

    def _hatched(self, ax: Axes, cells: Sequence[Cell | None], strip: int, colour: str) -> bool:
        if not any(cell is not None and any(cell.lack) for cell in cells):
            return False
        for at, cell in enumerate(cells):
            if cell is not None:
                width = self._edges[at + 1] - self._edges[at]
                self.lacks.add(ax, cell, (self._edges[at], strip * _STRIP, width, 0.9 * _STRIP), colour)
        return True

    def scales(self, ax: Axes, strips: int, log_scale: bool | None) -> None:
        """Set the axes of a panel that has so many hatched strips."""
        if self._logs:
            ax.set_xscale("log")
            plain_decades(ax.xaxis)
        if self._bars:
            ax.set_xticks(self._places, labels=[f"{place:g}" for place in self._places])
            ax.xaxis.set_minor_locator(NullLocator())
        if self._quantity.kind == "share":
            ax.set_ylim(-3.0, 103.0)
        elif log_scale and self._quantity.kind == "number":
            ax.set_yscale("log")
            plain_decades(ax.yaxis)
        else:
            ax.yaxis.set_major_formatter(ScalarFormatter(useOffset=False))
        if strips:
            ax.set_xlim(self._edges[0], self._edges[-1])
            room(ax, "y", strips * _STRIP + 0.02)

    def handles(self) -> list[Artist]:
        looks = zip(self.names, COLOURS, _MARKERS, strict=False)
        lines = [
            Line2D([], [], color=colour, linestyle=self._style(number), marker=marker, markersize=3.0,
                   label=text(value_words(name)))
            for number, (name, colour, marker) in enumerate(looks)
            if name is not None
        ]  # fmt: skip
        look: dict[str, Any] = {"alpha": 2 * BAND, "linewidth": 6.0}
        if self._bars:
            look = {"linestyle": "none", "marker": "|", "markersize": 7.0}
        band = Line2D([], [], color="0.5", label=interval_label(self._quantity), **look)
        return [*lines, *([band] if has_interval(self._quantity) else []), *self.lacks.handles()]


def _spread_places(places: Array, share: float, logs: bool) -> Array:
    at = np.log(places) if logs else places
    moved: Array = at + (share - 0.5) * (np.diff(at).min() if len(at) > 1 else 1.0) / 3
    return np.exp(moved) if logs else moved


def _edges(places: Array, logs: bool) -> Array:
    values = np.log(places) if logs else places
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.exp(edges) if logs else edges
