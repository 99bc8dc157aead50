"""Heat maps: a number over two others, with its interval in each cell, or beside it where cells are small."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite, isnan
from textwrap import fill

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure

from fleet.addons.pictures.caption import text_width_pt, write_caption
from fleet.addons.pictures.look import column_in, label_pt, page_in
from fleet.addons.pictures.style import panels
from fleet.addons.studies.pictures.marks import (
    DIVERGING,
    Digits,
    Lacks,
    Layout,
    Panel,
    axis_label,
    columns_of,
    estimate_words,
    few_ticks,
    has_interval,
    interval_label,
    legend,
    quantity_label,
    scale,
    used_axes,
)
from fleet.addons.studies.pictures.points import (
    Cell,
    Quantity,
)
from fleet.addons.studies.signal_measures import more_is_better
from fleet.addons.studies.statistics import Estimate
from fleet.mcap.records import Array

_BAR = 48  # characters of a line above the bar
_SMALL_PT = 5.0  # of intervals
_MARGIN_PT, _TICKS_PT = 20.0, 26.0  # of a page, and of each panel: what is left of the cells
_MOST_WORDS = 1000  # cells
_HATCHED = 0.1  # of the width of a cell: hatched where some of its runs lack the number
_CHARACTER_PT = 4.6  # along an axis
_CELL_PT = 21.0  # height of a cell with a value and an interval

_WIDTHS = LinearSegmentedColormap.from_list("widths", ("0.92", "black"))  # white: there is no interval
Tables = list[list[list[Cell | None]]]  # of each panel the rows, from below
Drawing = tuple[Callable[[Estimate], float], Normalize, Colormap, str]  # what is drawn, how, and what the bar says
Colour = tuple[float, float, float, float]


def heat(quantity: Quantity, layout: Layout, shown: Sequence[Panel], log_scale: bool | None) -> Figure:
    """Draw some panels of a layout with two axes."""
    x, y = (layout.dimensions[k] for k in layout.axes)
    columns = columns_of(len(shown))
    rows = -(-len(shown) // columns)
    width = column_in() if columns == 1 else page_in()
    cell_pt = (width * 72.0 - _MARGIN_PT) / columns - _TICKS_PT
    cell_pt /= len(x.values)
    tables = [_table(quantity, layout, panel) for panel in shown]
    digits = Digits(_each(tables, lambda estimate: estimate.value), scale(quantity))
    fits = _room(tables, cell_pt, digits)
    both = 2 if fits < 2 and _each(tables, lambda estimate: estimate.half) else 1
    cells = min(len(y.values) * (_CELL_PT if fits == 2 else 12.0) / 72.0, 4.0)  # of a panel [inches]
    titles = max(panel.title.count("\n") + bool(panel.title) for panel in shown) * 0.13  # [inches]
    height = rows * max(1.1, cells + 0.35 + titles) + 0.5
    figure, axes = panels(rows * both, columns, width, both * height, share=False)
    lacks = Lacks()
    drawings: list[Drawing] = [_values(quantity, tables, log_scale)]
    if both == 2:
        drawings.append(_widths(quantity, tables))
    for number, (of, norm, colours, label) in enumerate(drawings):
        part = axes[number * rows * columns : (number + 1) * rows * columns]
        for k, ax, _ in used_axes(part, shown):
            table = tables[k]
            image = [[np.nan if cell is None else of(cell.estimate) for cell in row] for row in table]
            found = np.array(image)
            _cells(ax, np.where(np.isfinite(found), found, np.nan), norm, colours)
            for row, line in enumerate(table):
                for column, cell in enumerate(line):
                    if cell is not None:
                        width = 1.0 if not cell.values else _HATCHED
                        lacks.add(ax, cell, (column + 0.5 - width, row - 0.5, width, 1.0))
                        if number == 0 and fits:
                            colour = colours(norm(of(cell.estimate)))
                            _words(ax, (column, row), cell, digits, quantity.kind == "difference", colour, fits)
            few_ticks(ax.xaxis, [f"{value:g}" for value in x.values], max(3, int(cell_pt * len(x.values) / 22.0)))
            few_ticks(ax.yaxis, [f"{value:g}" for value in y.values], 14)
            if k % columns == 0:
                ax.set_ylabel(fill(axis_label(y), max(10, int(max(cells, 0.7) * 72.0 / _CHARACTER_PT))))
            if k + columns >= len(shown):
                ax.set_xlabel(axis_label(x))
        bar = figure.colorbar(part[0].images[0], ax=part, location="top", aspect=25 * columns, pad=0.03, fraction=0.08)
        bar.set_label(label)
        bar.ax.grid(False)
    lacks.draw()
    legend(figure, lacks.handles())
    beside = "; below each number its interval" if fits == 2 else ""
    write_caption(figure, [estimate_words(quantity) + (beside if has_interval(quantity) else "")])
    return figure


def _table(quantity: Quantity, layout: Layout, panel: Panel) -> list[list[Cell | None]]:
    x, y = layout.axes
    along = [layout.dimensions[k].values for k in (x, y)]
    return [[quantity.cells.get(layout.key(panel, {x: a, y: b})) for a in along[0]] for b in along[1]]


def _values(quantity: Quantity, tables: Tables, log_scale: bool | None) -> Drawing:
    factor = scale(quantity)
    found = [factor * v for v in _each(tables, lambda estimate: estimate.value)] or [0.0]
    label = quantity_label(quantity, _BAR * (1 if len(tables) == 1 else 2))

    def value(estimate: Estimate) -> float:
        return factor * estimate.value

    more = quantity.kind == "share" or more_is_better(quantity.name)
    if quantity.kind == "difference":
        most = max(map(abs, found)) or 1.0
        return value, Normalize(-most, most), DIVERGING.reversed() if more else DIVERGING, label
    colours = colormaps["cividis" if more else "cividis_r"]  # bright is good
    if quantity.kind == "share":
        return value, Normalize(0.0, 100.0), colours, label
    positive = [v for v in found if v > 0.0]
    if log_scale and len(positive) > 1 and min(positive) < max(positive):
        return value, LogNorm(min(positive), max(positive)), colours, label
    return value, Normalize(min(found), max(found)), colours, label


def _widths(quantity: Quantity, tables: Tables) -> Drawing:
    factor = scale(quantity)
    found = [2.0 * factor * v for v in _each(tables, lambda estimate: estimate.half)] or [1.0]
    norm = Normalize(0.0, max(found) or 1.0)
    return lambda estimate: 2.0 * factor * estimate.half, norm, _WIDTHS, f"width of the {interval_label(quantity)}"


def _each(tables: Tables, of: Callable[[Estimate], float]) -> list[float]:
    cells = [cell for table in tables for row in table for cell in row if cell is not None]
    return [number for number in (of(cell.estimate) for cell in cells) if isfinite(number)]


def _cells(ax: Axes, image: Array, norm: Normalize, colours: Colormap) -> None:
    ax.set_facecolor("white")
    ax.imshow(image, norm=norm, cmap=colours, aspect="auto", origin="lower", interpolation="nearest")
    ax.grid(False)
    if max(image.shape) <= 30:
        for edge in np.arange(image.shape[1] - 1) + 0.5:
            ax.axvline(edge, color="white", linewidth=0.8)
        for edge in np.arange(image.shape[0] - 1) + 0.5:
            ax.axhline(edge, color="white", linewidth=0.8)
    ax.tick_params(length=0)


def _room(tables: Tables, cell_pt: float, digits: Digits) -> int:
    if sum(len(table) * len(table[0]) for table in tables) > _MOST_WORDS:
        return 0
    widest, strip = [0.0, 0.0], 0.0
    for cell in (cell for table in tables for row in table for cell in row if cell is not None):
        estimate = cell.estimate
        strip = _HATCHED if any(cell.lack) else strip
        if not isnan(estimate.value):
            widest[0] = max(widest[0], text_width_pt(digits.value(estimate), label_pt()))
        if not isnan(estimate.low):
            widest[1] = max(widest[1], text_width_pt(digits.interval(estimate), _SMALL_PT))
    return 0 if widest[0] > cell_pt - 2.0 else 1 if widest[1] > (1.0 - strip) * cell_pt - 2.0 else 2


def _words(ax: Axes, at: tuple[int, int], cell: Cell, digits: Digits, bold: bool, colour: Colour, fits: int) -> None:
    estimate = cell.estimate
    if isnan(estimate.value):
        return
    certain = bold and (estimate.low > 0.0 or estimate.high < 0.0)
    both = fits == 2 and not isnan(estimate.low)
    lines = [(0.18 if both else 0.0, digits.value(estimate), label_pt(), "bold" if certain else "normal")]
    if both:
        lines.append((-0.2, digits.interval(estimate), _SMALL_PT, "normal"))
    dark = isfinite(estimate.value) and 0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2] < 0.5
    left = _HATCHED / 2 if any(cell.lack) else 0.0
    for above, words, size, weight in lines:
        ax.text(
            at[0] - left, at[1] + above, words, ha="center", va="center", fontsize=size, weight=weight, gid="cell",
            color="white" if dark else "black",
        )  # fmt: skip
