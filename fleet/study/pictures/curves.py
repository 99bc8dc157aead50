"""Curves with bands: a number and its interval over what is varied, one line for each word."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator, ScalarFormatter

from fleet.logs.records import Array
from fleet.palette import COLOURS
from fleet.pictures.style import COLUMN_IN, PAGE_IN, STYLES, limit, panels, plain_decades
from fleet.study.pictures.layout import Layout, Panel
from fleet.study.pictures.marks import (
    BAND,
    Lacks,
    axis_label,
    columns_of,
    interval_label,
    legend,
    logarithmic,
    quantity_label,
    room,
    scale,
    text,
)
from fleet.study.pictures.points import Quantity, Value
from fleet.study.pictures.words import value_words

_MARKERS = "osD^vP*"
_MOST_BANDS, _MOST_BARS = 3, 12  # more lines have a bar at each place, if there are no more places
_STRIP = 0.07  # height of the hatched strip of a line, of the axis


def curves(quantity: Quantity, layout: Layout, shown: Sequence[Panel], log_scale: bool | None) -> Figure:
    """Draw some panels of a layout with one axis; intervals are bands, of many lines bars side by side."""
    (x,) = layout.axes
    along = layout.dimensions[x]
    places = np.array(along.values, float)
    logs = logarithmic(places.tolist())
    columns = columns_of(len(shown))
    rows = -(-len(shown) // columns)
    figure, axes = panels(rows, columns, COLUMN_IN if columns == 1 else PAGE_IN, 2.1 * rows + 0.2, share=False)
    names: tuple[Value | None, ...] = (None,) if layout.lines is None else layout.dimensions[layout.lines].values
    lacks, factor = Lacks(), scale(quantity)
    edges = _edges(places, logs)
    bars = len(names) > _MOST_BANDS and len(places) <= _MOST_BARS
    for k, ax in enumerate(axes):
        if k >= len(shown):
            ax.set_visible(False)
            continue
        if quantity.kind == "difference":
            limit(ax, 0.0)
        strips = 0
        for number, name in enumerate(names):
            fixed = {} if name is None or layout.lines is None else {layout.lines: name}
            cells = [quantity.cells.get(layout.key(shown[k], fixed | {x: value})) for value in along.values]
            there = [cell.estimate if cell is not None else (np.nan,) * 3 for cell in cells]
            found = factor * np.array([each[:3] for each in there], float)
            highest = found[np.isfinite(found)].max(initial=-np.inf)
            found[:, 2][np.isposinf(found[:, 2])] = highest  # half of the runs or more may lack the number
            found[~np.isfinite(found)] = np.nan
            colour = COLOURS[number]
            where = _beside(places, (number + 0.5) / len(names), logs) if bars else places
            if bars:
                ax.vlines(where, found[:, 1], found[:, 2], color=colour, linewidth=1.2, gid="band")
            else:
                ax.fill_between(where, found[:, 1], found[:, 2], color=colour, alpha=BAND, linewidth=0, gid="band")
            ax.plot(where, found[:, 0], color=colour, linestyle=STYLES[number], marker=_MARKERS[number],
                    linewidth=0.6 if bars else None, markersize=3.0 if len(places) < 40 else 1.5,
                    gid="curve")  # fmt: skip
            if any(cell is not None and any(cell.lack) for cell in cells):
                for at, cell in enumerate(cells):
                    if cell is not None:
                        rectangle = edges[at], strips * _STRIP, edges[at + 1] - edges[at], 0.9 * _STRIP
                        lacks.add(ax, cell, rectangle, colour)
                strips += 1
        if logs:
            ax.set_xscale("log")
            plain_decades(ax.xaxis)
        if bars:
            ax.set_xticks(places, labels=[f"{place:g}" for place in places])
            ax.xaxis.set_minor_locator(NullLocator())
        if quantity.kind == "share":
            ax.set_ylim(-3.0, 103.0)
        elif log_scale and quantity.kind == "number":
            ax.set_yscale("log")
            plain_decades(ax.yaxis)
        else:
            ax.yaxis.set_major_formatter(ScalarFormatter(useOffset=False))
        if strips:
            ax.set_xlim(edges[0], edges[-1])
            room(ax, "y", strips * _STRIP + 0.02)
        if k % columns == 0:
            ax.set_ylabel(quantity_label(quantity))
        if k + columns >= len(shown):
            ax.set_xlabel(axis_label(along))
        if shown[k].title:
            ax.set_title(shown[k].title)
    lacks.draw(lambda ax: ax.get_xaxis_transform())
    lines = [
        Line2D(
            [],
            [],
            color=COLOURS[k],
            linestyle=STYLES[k],
            marker=_MARKERS[k],
            markersize=3.0,
            label=text(value_words(name)),
        )
        for k, name in enumerate(names)
        if name is not None
    ]
    band = Line2D([], [], color="0.5", alpha=2 * BAND, linewidth=6.0, label=interval_label(quantity))
    if bars:
        band = Line2D([], [], color="0.5", linestyle="none", marker="|", markersize=7.0, label=interval_label(quantity))
    legend(figure, [*lines, band, *lacks.handles()])
    return figure


def _beside(places: Array, share: float, logs: bool) -> Array:
    """Places moved aside; shares from 0 to 1 fill a third of the least distance around each."""
    at = np.log(places) if logs else places
    moved: Array = at + (share - 0.5) * (np.diff(at).min() if len(at) > 1 else 1.0) / 3
    return np.exp(moved) if logs else moved


def _edges(places: Array, logs: bool) -> Array:
    """Where the part of the axis that belongs to each place begins and ends; one more than there are places."""
    values = np.log(places) if logs else places
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.exp(edges) if logs else edges
