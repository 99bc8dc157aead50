"""Parallel coordinates of a sampled study: one line per run through what was varied and what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fleet.logs.records import Array
from fleet.palette import COLOURS
from fleet.pictures.runs import NothingToDraw
from fleet.pictures.style import COLUMN_IN, LABEL_PT, PAGE_IN, THIN, panels
from fleet.study.pictures.marks import axis_label, legend, logarithmic, rough, spans_much, text, wrapped
from fleet.study.pictures.points import NO_RESULT, NOT_MADE, PASSED, Points, VariedKey
from fleet.study.pictures.words import value_words

MOST_AXES = 12
_WIDE = 5  # axes: more need the width of a page
_LINES = 3000  # more runs than these are no picture any more, but ink
_CASES = ((1.0, "passed", COLOURS[0], "-"), (0.0, "failed", COLOURS[1], "-"))
_NONE = ("without a result", "0.5", (0, (3, 2)))


def parallel(points: Points, measures: Sequence[str], log_scale: bool | None) -> Figure:
    """Draw every run as a line through the dimensions and measures, in the colour of its verdict.

    Raises:
        NothingToDraw: there are no runs, or too many axes.
    """
    dimensions = [(k, each) for k, each in enumerate(points.dimensions) if len(each.values) > 1]
    count = len(dimensions) + len(measures)
    if count > MOST_AXES:
        raise NothingToDraw(f"{count} axes do not fit into a picture: {MOST_AXES} do; choose fewer with --measure")
    made = np.argwhere(points.state >= NO_RESULT)
    if not len(made):
        raise NothingToDraw("no run has been made yet")
    made = made[:: -(-len(made) // _LINES)]
    width = COLUMN_IN if count <= _WIDE else PAGE_IN
    figure, (ax,) = panels(1, 1, width, 2.9)
    columns = [
        _dimension(ax, at, each, [points.keys[p][k] for p, _ in made]) for at, (k, each) in enumerate(dimensions)
    ]
    for at, name in enumerate(measures, start=len(dimensions)):
        columns.append(_measure(ax, at, points.numbers[name][made[:, 0], made[:, 1]], log_scale))
    lines = np.stack([np.broadcast_to(np.arange(count), (len(made), count)), np.stack(columns, 1)], 2)
    verdicts = points.numbers[PASSED][made[:, 0], made[:, 1]]
    often = {value: int((verdicts == value).sum()) for value, *_ in _CASES}
    handles = []
    for value, name, colour, style in sorted(_CASES, key=lambda case: -often[case[0]]):  # the rarer above
        handles.append(_draw(ax, lines[verdicts == value], f"{often[value]} {name}", colour, style))
    if none := int(np.isnan(verdicts).sum()):
        handles.append(_draw(ax, lines[np.isnan(verdicts)], f"{none} {_NONE[0]}", *_NONE[1:]))
    if left := int((points.state == NOT_MADE).sum()):
        handles.append(Line2D([], [], color="none", label=f"{left} not made yet"))
    labels = [axis_label(each) for _, each in dimensions] + [wrapped(points.words(name), 18) for name in measures]
    ax.set_xticks(range(count), labels=labels, fontsize=LABEL_PT)
    ax.set_yticks([])
    ax.set_xlim(-0.25, count - 0.6)
    ax.set_ylim(-0.04, 1.06)
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    legend(figure, handles)
    return figure


def _draw(ax: Axes, lines: Array, label: str, colour: str, style: Any) -> Line2D:
    alpha = 0.75 if len(lines) < 100 else 0.35
    found = LineCollection(list(lines), colors=colour, linewidths=THIN, linestyles=[style], alpha=alpha, gid="runs")
    ax.add_collection(found, autolim=False)
    return Line2D([], [], color=colour, linestyle=style, label=label)


def _dimension(ax: Axes, at: int, dimension: VariedKey, values: Sequence[float | str]) -> Array:
    """Draw the axis of a dimension; returns where its values are on it, from 0 to 1."""
    if dimension.unit is not None:
        return _numbers(ax, at, np.array(values, float), logarithmic(map(float, dimension.values)))
    places = {value: k / (len(dimension.values) - 1) for k, value in enumerate(dimension.values)}
    _axis(ax, at, [(place, text(value_words(value), 12)) for value, place in places.items()])
    return np.array([places[value] for value in values])


def _measure(ax: Axes, at: int, values: Array, log_scale: bool | None) -> Array:
    known = values[np.isfinite(values)]
    positive = len(known) > 0 and known.min() > 0.0
    return _numbers(ax, at, values, spans_much(known.tolist()) if log_scale is None else log_scale and positive)


def _numbers(ax: Axes, at: int, values: Array, logs: bool) -> Array:
    values = np.where(np.isfinite(values), values, np.nan)
    known = values[np.isfinite(values)]
    if not len(known):
        _axis(ax, at, [(0.5, "no run has it")])
        return values
    low, high = float(known.min()), float(known.max())
    if low == high:
        _axis(ax, at, [(0.5, rough(low))])
        return np.where(np.isfinite(values), 0.5, np.nan)
    turned = np.log(values) if logs else values
    first, last = (np.log(low), np.log(high)) if logs else (low, high)
    shown = [(share, first + share * (last - first)) for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    _axis(ax, at, [(share, rough(float(np.exp(value) if logs else value))) for share, value in shown])
    found: Array = (turned - first) / (last - first)
    return found


def _axis(ax: Axes, at: int, marks: Sequence[tuple[float, str]]) -> None:
    ax.plot([at, at], [0.0, 1.0], color="black", linewidth=0.6, zorder=3)
    for share, shown in marks:
        ax.annotate(
            shown, (at, share), xytext=(2.5, 0.0), textcoords="offset points", va="center", fontsize=LABEL_PT,
            zorder=4, bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "alpha": 0.75, "linewidth": 0.0},
        )  # fmt: skip
