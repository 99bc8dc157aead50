"""Boxes by factor: every run as a point, the box of the middle half, and the median with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import isfinite

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fleet.addons.pictures.caption import text_width_pt, write_caption
from fleet.addons.pictures.look import column_in, label_pt, page_in, text_pt
from fleet.addons.pictures.runs import NothingToDraw
from fleet.addons.pictures.style import panels, plain_decades
from fleet.addons.studies.pictures.marks import (
    BAND,
    Lacks,
    Layout,
    Panel,
    axis_label,
    estimate_words,
    interval_label,
    legend,
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
from fleet.palette import COLOURS

MOST_ROWS = 60
_ROW_IN = 0.24
_LACK = 0.06  # width of the hatched part, of the axis
_SPREAD = 0.28  # of the points, across
_WORDS = 50  # characters of a line below the axis


def boxes(quantity: Quantity, layout: Layout, shown: Sequence[Panel], log_scale: bool | None) -> Figure:
    """Draw some panels of a layout over words: a row for each value, from above. Raises NothingToDraw: there are too
    many values."""
    drawn = _Boxes(quantity, layout)
    columns = min(2, len(shown))
    rows = -(-len(shown) // columns)
    label = axis_label(layout.dimensions[layout.axes[0]]) if layout.axes else ""
    height = rows * max(_ROW_IN * drawn.count + 0.55, text_width_pt(label, text_pt()) / 72.0 + 0.1) + 0.3
    figure, axes = panels(rows, columns, column_in() if columns == 1 else page_in(), height, share=False)
    for k, ax, panel in used_axes(axes, shown):
        if quantity.kind == "difference":
            ax.axvline(0.0, color="0.45", linewidth=0.7, linestyle=(0, (4, 3)))
        drawn.scales(ax, log_scale, lacking=drawn.panel(ax, panel))
        if k % columns == 0:
            ax.set_ylabel(label)
    for ax in axes[max(0, len(shown) - columns) : len(shown)]:
        ax.set_xlabel(quantity_label(quantity, _WORDS))
    drawn.lacks.draw(lambda ax: ax.get_yaxis_transform())
    legend(figure, drawn.handles())
    write_caption(figure, [estimate_words(quantity)])
    return figure


class _Boxes:
    def __init__(self, quantity: Quantity, layout: Layout) -> None:
        """Raises NothingToDraw: there are too many values."""
        self._quantity, self._layout, self.lacks = quantity, layout, Lacks()
        self._names, self._colours = (self._values(place) for place in ((*layout.axes, None)[0], layout.lines))
        self.count = len(self._names) * len(self._colours)
        if self.count > MOST_ROWS:
            raise NothingToDraw(f"{self.count} boxes do not fit into a picture: {MOST_ROWS} do")

    def _values(self, place: int | None) -> tuple[Value | None, ...]:
        return (None,) if place is None else self._layout.dimensions[place].values

    def panel(self, ax: Axes, panel: Panel) -> bool:
        """Draw all rows; returns whether some runs lack the number."""
        lacking, share = False, 1.0 / len(self._colours)
        for (row, name), (number, colour) in product(enumerate(self._names), enumerate(self._colours)):
            values = {} if name is None else {self._layout.axes[0]: name}
            if self._layout.lines is not None and colour is not None:
                values[self._layout.lines] = colour
            cell = self._quantity.cells.get(self._layout.key(panel, values))
            if cell is not None:
                at = row + (number + 0.5) * share - 0.5
                _one(ax, self._quantity, cell, at, share, COLOURS[number])
                self.lacks.add(ax, cell, (1.0 - _LACK, at + 0.45 * share, _LACK, -0.9 * share))
                lacking |= any(cell.lack)
        return lacking

    def scales(self, ax: Axes, log_scale: bool | None, *, lacking: bool) -> None:
        labels = [text("all runs" if name is None else value_words(name)) for name in self._names]
        ax.set_yticks(range(len(labels)), labels=labels)
        ax.set_ylim(len(labels) - 0.45, -0.55)
        ax.grid(visible=False, axis="y")
        if self._quantity.kind == "share":
            ax.set_xlim(-3.0, 103.0)
        elif log_scale and self._quantity.kind == "number":
            ax.set_xscale("log")
            plain_decades(ax.xaxis)
        else:
            ax.use_sticky_edges = False  # a box is no bar that begins at the frame
        if lacking:
            room(ax, "x", _LACK + 0.01)

    def handles(self) -> list[Artist]:
        coloured = [
            Patch(color=COLOURS[k], alpha=2 * BAND, linewidth=0, label=text(value_words(name)))
            for k, name in enumerate(self._colours)
            if name is not None
        ]
        label = f"{'share' if self._quantity.kind == 'share' else 'median'}, {interval_label(self._quantity)}"
        middle = Line2D([], [], color="black", marker="|", markersize=5.0, linewidth=1.2, label=label)
        return [*coloured, middle, *self.lacks.handles()]


def _one(ax: Axes, quantity: Quantity, cell: Cell, at: float, width: float, colour: str) -> None:
    estimate, factor = cell.estimate, scale(quantity)
    if not cell.values:
        return
    if quantity.kind == "share":
        ax.barh(at, factor * estimate.value, 0.7 * width, color=colour, alpha=2 * BAND, linewidth=0, gid="share")
        words = f"{sum(cell.values):.0f} of {len(cell.values)}"
        ax.annotate(
            words, (1.0, at), xycoords=ax.get_yaxis_transform(), xytext=(3.0, 0.0), textcoords="offset points",
            va="center", fontsize=label_pt(), annotation_clip=False,
        )  # fmt: skip
    else:
        values = np.array(cell.values)
        low, high = np.percentile(values, (25.0, 75.0))
        ax.barh(at, high - low, 0.7 * width, left=low, color=colour, alpha=2 * BAND, linewidth=0, gid="box")
        turns = (np.arange(len(values)) * 0.618034) % 1.0 - 0.5  # even, and the same each time
        size = 5.0 if len(values) < 100 else 1.0
        ax.scatter(values, at + 2.0 * _SPREAD * width * turns, s=size, color=colour, linewidth=0, zorder=2, gid="runs")
    if isfinite(estimate.low):
        high = estimate.high if isfinite(estimate.high) else max(cell.values)
        ends = [factor * estimate.low, factor * high]
        ax.plot(ends, [at, at], color="black", linewidth=1.2, zorder=3, gid="interval")
    if isfinite(estimate.value):
        size = 3.0 + 10.0 * width
        ax.plot([factor * estimate.value], [at], color="black", marker="|", markersize=size, zorder=3, gid="middle")
