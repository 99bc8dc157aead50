"""The kinds of pictures of a study: boxes, curves with bands, and heat maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from math import isfinite, isnan
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullLocator, ScalarFormatter

from fleet.addons.pictures.caption import text_width_pt, write_caption
from fleet.addons.pictures.look import column_in, label_pt, page_in, text_pt
from fleet.addons.pictures.runs import NothingToDraw
from fleet.addons.pictures.style import STYLES, limit, panels, plain_decades
from fleet.addons.studies.measures import more_is_better
from fleet.addons.studies.pictures.marks import (
    BAND,
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
from fleet.addons.studies.statistics import Estimate
from fleet.mcap.records import Array
from fleet.palette import COLOURS

# Boxes by factor: every run as a point, the box of the middle half, and the median with its interval.

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


# Curves with bands: a number and its interval over what is varied, one line for each word.

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
            where = _beside(self._places, (number + 0.5) / len(self.names), self._logs)
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


def _beside(places: Array, share: float, logs: bool) -> Array:
    at = np.log(places) if logs else places
    moved: Array = at + (share - 0.5) * (np.diff(at).min() if len(at) > 1 else 1.0) / 3
    return np.exp(moved) if logs else moved


def _edges(places: Array, logs: bool) -> Array:
    values = np.log(places) if logs else places
    middle = (values[1:] + values[:-1]) / 2
    edges = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.exp(edges) if logs else edges


# Heat maps: a number over two others, with its interval in each cell, or beside it where cells are small.

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
