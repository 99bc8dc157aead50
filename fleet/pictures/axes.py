"""The common part of pictures over time: lines by vehicle or by run, shaded faults, one legend, words below."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation

from fleet.logs.fault_intervals import FaultInterval
from fleet.logs.records import Array
from fleet.palette import COLOURS
from fleet.pictures.bands import Series, band_legend, draw_band, outlier_style, outliers, spread
from fleet.pictures.envelope import enveloped, reach
from fleet.pictures.failures import draw_failures
from fleet.pictures.runs import NothingToDraw, Run, View, first_words
from fleet.pictures.shades import shade
from fleet.pictures.style import COLUMN_IN, LABEL_PT, LEGEND_PT, STYLE_NAMES, STYLES, TEXT_PT, THIN, panels

MOST_NAMED = len(COLOURS)  # lines that a legend names; more vehicles are a band
FEW = 60  # samples that are shown as points too

Get = Callable[[Run, int], tuple[Array, Array] | None]


def over_time(
    rows: int, runs: Sequence[Run], view: View, height: float | None = None, ratios: Sequence[float] | None = None
) -> tuple[Figure, list[Axes]]:
    """Axes above each other that share the time axis, at column width."""
    figure, axes = panels(rows, 1, COLUMN_IN, height or 1.3 * rows + 0.8, ratios)
    end = max(run.log.end for run in runs)
    axes[0].set_xlim(*(view.window or (0.0, end or 1.0)))
    return figure, axes


def finish(figure: Figure, axes: Sequence[Axes], runs: Sequence[Run], notes: Sequence[str] = ()) -> None:
    """Shade the faults, name them above the first axis, label the time axis and put the words below it."""
    named = _shade(axes, runs)
    lines = [*named, *draw_failures(axes, runs), *notes, *(_cut(run, len(runs)) for run in runs if run.log.missing)]
    axes[-1].set_xlabel("\n".join(["time [s]", *lines]))
    rows = {text.xyann[1] for text in axes[0].texts if isinstance(text, Annotation) and text.get_gid() == "fault-name"}
    _grow(figure, TEXT_PT * len(lines) + LABEL_PT * len(rows))
    figure.align_ylabels(list(axes))


def _cut(run: Run, runs: int) -> str:
    return f"{run.label + ': ' if runs > 1 else ''}the log is not whole, it ends at {run.log.end:g} s"


def draw_lines(
    figure: Figure,
    panel: Sequence[tuple[Axes, Get]],
    runs: Sequence[Run],
    view: View,
    whose: str = "",
    log: bool = False,
    exact: bool = False,
    **style: Any,
) -> list[str]:
    """Draw one line per vehicle into each panel, in the vehicle's colour, or in the run's. Many vehicles make a band.

    Args:
        panel: the axes, each with the function that gets its signal.
        runs: the runs to draw.
        view: the vehicles and the span of time.
        whose: the laws that report such a signal; for the message if no vehicle reports it.
        log: the signals are errors on a logarithmic axis. Outliers are chosen on this axis.
        exact: the line goes through every sample, also if a signal oscillates too fast to be seen.
        style: style of each vehicle's line.

    Returns:
        words on vehicles that have no such signal.

    Raises:
        NothingToDraw: no vehicle has it.
    """
    by_run = len(runs) > 1
    each = [[_series(run, view, get) for _, get in panel] for run in runs]
    if not any(signals for found in each for signals in found):
        if not any(run.vehicles(view) for run in runs):
            raise NothingToDraw("the log has no such vehicle" if view.vehicles else "the log has no vehicles")
        raise NothingToDraw(f"no vehicle reports it{f': {whose}' if whose else ''}")
    entries: list[Artist] = []
    notes = []
    too_fast = False
    for r, (run, found) in enumerate(zip(runs, each, strict=True)):
        of_run: dict[str, Any] = {"color": COLOURS[r % len(COLOURS)], "linestyle": STYLES[r % len(STYLES)]}
        vehicles = run.vehicles(view)
        reported = sorted({i for signals in found for i in signals})
        if len(vehicles) > MOST_NAMED:
            styles, entries = _draw_bands([ax for ax, _ in panel], found, of_run, log, name=not by_run)
        elif by_run:
            styles = {i: of_run | {"linewidth": THIN} for i in reported}
        else:
            styles = {i: {"color": COLOURS[k], "linestyle": STYLES[k]} for k, i in enumerate(vehicles) if i in reported}
            entries = [Line2D([], [], label=f"UUV {i}", **one) for i, one in styles.items()]
        for (ax, _), signals in zip(panel, found, strict=True):
            whole = 0.0 if exact else reach(signals.values(), log)
            for i in sorted(signals.keys() & styles.keys()):
                too_fast |= _draw_line(ax, f"{run.slug}-vehicle-{i}", signals[i], whole, log, styles[i] | style)
        if silent := [i for i in vehicles if i not in reported]:
            notes.append(f"{run.label + ': ' if by_run else ''}not reported by UUV {first_words(silent)}")
    if too_fast:
        notes.append("shaded: oscillates too fast to be drawn; line: its mean")
    if by_run:
        _legend_of_runs(figure, runs)
    elif len(entries) > 1:
        marks_legend(figure, entries)
    return notes


def _draw_bands(
    axes: Sequence[Axes], found: Sequence[Mapping[int, Series]], style: dict[str, Any], log: bool, *, name: bool
) -> tuple[dict[int, dict[str, Any]], list[Artist]]:
    """A band of the many vehicles of a run on each axis.

    Args:
        found: the series of each vehicle, for each axis.
        style: colour and dashes of the run.
        name: whether outliers are drawn and named.

    Returns:
        the style of the line of each outlier, and the entries of the legend.
    """
    spreads = [spread(signals) if signals else None for signals in found]
    for ax, one in zip(axes, spreads, strict=True):
        if one is not None:
            draw_band(ax, one, style["color"], style["linestyle"])
    named = outliers([one for one in spreads if one is not None], log) if name else []
    reported = {i for signals in found for i in signals}
    return {i: outlier_style(k) for k, i in enumerate(named)}, band_legend(len(reported), named)


def _legend_of_runs(figure: Figure, runs: Sequence[Run]) -> None:
    """Each run by its colour, and by its dashes in words: what a dash means is not seen in a short sample of it."""
    rows = []
    for r, run in enumerate(runs):
        k = r % len(STYLES)
        rows.append((f"{STYLE_NAMES[k]}: {run.label}", COLOURS[r % len(COLOURS)], STYLES[k]))
    legend_of(figure, rows)


def _draw_line(ax: Axes, gid: str, series: Series, whole: float, log: bool, style: dict[str, Any]) -> bool:
    """Draw the line of a vehicle, or its envelope if it oscillates too fast. Returns whether it is the envelope."""
    first, last = ax.get_xlim()
    (t, values), around = enveloped(*series, (first, last), whole, log)
    if around is not None:
        ax.fill_between(
            around.t, around.low, around.high, color=style["color"], alpha=0.22, linewidth=0, gid=f"{gid}-envelope"
        )
        style = style | {"drawstyle": "default"}  # means are not held
    ax.plot(t, values, gid=gid, marker="." if len(t) < FEW else "", markersize=3, **style)
    return around is not None


def _series(run: Run, view: View, get: Get) -> dict[int, Series]:
    """A signal of each vehicle that reports it, in the window."""
    found = {i: get(run, i) for i in run.vehicles(view)}
    return {i: within(*one, view.window) for i, one in found.items() if one is not None}


def within(t: Array, values: Array, window: tuple[float, float] | None) -> Series:
    """The samples in a window, and one before and one behind it, so that a line reaches the edges."""
    if window is None:
        return t, values
    before, behind = np.flatnonzero(t <= window[0]), np.flatnonzero(t >= window[1])
    part = slice(before[-1] if len(before) else 0, behind[0] + 1 if len(behind) else len(t))
    return t[part], values[part]


def legend_of(figure: Figure, entries: Sequence[tuple[str, Any, Any]]) -> None:
    """One legend of lines above all axes."""
    marks_legend(figure, [Line2D([], [], color=c, linestyle=style, label=label) for label, c, style in entries])


def marks_legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """One legend above all axes, in as few rows as fit."""
    widths = [22.0 + 4.1 * len(str(handle.get_label())) for handle in handles]  # pt

    def needed(columns: int) -> float:
        rows = -(-len(widths) // columns)  # a legend is filled column by column
        return sum(max(widths[k : k + rows]) for k in range(0, len(widths), rows))

    fitting = next((n for n in range(len(widths), 1, -1) if needed(n) <= 72.0 * COLUMN_IN), 1)
    fitting = -(-len(widths) // -(-len(widths) // fitting))  # rows of about the same length
    _grow(figure, LEGEND_PT * (-(-len(widths) // fitting) - 1))
    figure.legend(
        handles=list(handles), loc="outside upper center", ncols=fitting,
        columnspacing=1.0, handlelength=1.8, handletextpad=0.5,
    )  # fmt: skip


def _grow(figure: Figure, points: float) -> None:
    """Make room for more lines of text, of so many points together, so that the axes keep their height."""
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + 1.5 * points / 72.0)


def bounds(ax: Axes, values: Sequence[tuple[float, float]], what: str, unit: str) -> str:
    """Limits as thin dashed lines where the lines come near them; where not, a word on them."""
    low, high = ax.get_ylim()
    reach = max(abs(low), abs(high))
    limits = sorted({value for pair in values for value in pair})
    near = [value for value in limits if abs(value) <= 2.5 * reach]
    for value in near:
        ax.axhline(value, color="0.35", linewidth=0.7, linestyle=(0, (4, 3)), gid="bound")
    if near:
        room = 0.06 * (max(high, *near) - min(low, *near))  # so that a bound is not the frame
        ax.set_ylim(min(low, near[0] - room), max(high, near[-1] + room))
    far = ", ".join(f"{value:g}" for value in limits if value not in near)
    return f"outside: {what}, {far} {unit}" if far else ""


def _shade(axes: Sequence[Axes], runs: Sequence[Run]) -> list[str]:
    whose: dict[FaultInterval, list[str]] = {}
    for run in runs:
        for fault in (*run.log.faults, *run.log.events):
            whose.setdefault(fault, []).append(run.label)
    # A fault that not every run had is named with those that had it.
    called = [
        fault if len(labels) == len(runs) else fault._replace(what=f"{fault.what} ({', '.join(labels)})")
        for fault, labels in whose.items()
    ]
    return shade(axes, called)
