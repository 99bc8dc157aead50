"""The common part of pictures over time: lines by vehicle or by run, shaded faults, one legend, words below."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation

from fleet.addons.pictures.caption import text_width_pt, write_caption
from fleet.addons.pictures.look import column_in, label_pt, legend_pt
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View, first_words
from fleet.addons.pictures.shades import MOST_CHARACTERS, shade, words
from fleet.addons.pictures.style import HALO, NORMAL, STYLE_NAMES, STYLES, THIN, limit, panels
from fleet.mcap.records import Array
from fleet.palette import COLOURS
from fleet.scenario.sections.timeline import FaultInterval

MOST_MARKS = 6
_ROOM = 0.06  # of the axis: what a number needs
COLOUR = "#a4001d"


def draw_failures(axes: Sequence[Axes], runs: Sequence[LoggedRun]) -> list[str]:
    """A line across all axes at each moment, numbered above the first; returns what each number stands for."""
    begin, end = axes[0].get_xlim()
    by_time: dict[float, list[str]] = {}
    for run in runs:
        of = f" ({run.label})" if len(runs) > 1 else ""
        for name, at_s in run.failures:
            by_time.setdefault(at_s, []).append(f"{name}{of}")
    shown = [(at_s, names) for at_s, names in sorted(by_time.items()) if begin <= at_s <= end]
    words, rows = [], list[float]()  # of each row of numbers above each other where its last one stands
    for number, (at_s, names) in enumerate(shown[:MOST_MARKS], start=1):
        for ax in axes:
            ax.axvline(at_s, color=COLOUR, linewidth=0.9, linestyle=(0, (1, 1)), zorder=4, gid="failed-check")
        row = next((k for k, last in enumerate(rows) if at_s - last > _ROOM * (end - begin)), len(rows))
        rows[row : row + 1] = [at_s]
        axes[0].annotate(
            f"✗{number}", (at_s, 0.0), xycoords=("data", "axes fraction"), textcoords="offset points",
            xytext=(1.5, 2 + row * (label_pt() + 2)), color=COLOUR, fontsize=label_pt(), ha="left", va="bottom",
            zorder=5, gid="failed-check-name", path_effects=HALO,
        )  # fmt: skip
        words.append(f"✗{number}  fails at {at_s:g} s: {', '.join(names)}")
    return words + ([f"and at {len(shown) - MOST_MARKS} more times"] if len(shown) > MOST_MARKS else [])


NAMED = 3  # outliers
SMALLEST = 1e-6  # of an error: below it is arithmetic, not control
_BINS = 600
BAND = "0.35"  # no vehicle has this colour
_ALL, _MOST = 0.16, 0.32  # opacity of the band of all vehicles, and of that of most

Series = tuple[Array, Array]  # times [s], values


@dataclass(frozen=True, slots=True)
class Band:
    """The spread of many vehicles in each of some intervals of time; arrays of one length."""

    t: Array  # s
    low: Array  # the least of all samples
    high: Array
    most_low: Array  # 10 % and 90 % of the vehicles, by their means
    most_high: Array
    median: Array
    means: dict[int, Array]  # vehicle -> its mean, NaN where it has none


def spread(series: Mapping[int, Series]) -> Band:
    """The spread of signals of vehicles; short peaks stay within its extremes."""
    times = np.unique(np.concatenate([t[np.isfinite(t)] for t, _ in series.values()]))
    if len(times) > _BINS:
        edges = np.linspace(times[0], times[-1], _BINS + 1)
        middle = (edges[1:] + edges[:-1]) / 2
    else:
        edges, middle = np.append(times, np.inf), times
    low, high = np.full(len(middle), np.inf), np.full(len(middle), -np.inf)
    means: dict[int, Array] = {}
    for i, (t, values) in series.items():
        good = np.isfinite(t) & np.isfinite(values)
        place = np.clip(np.searchsorted(edges, t[good], "right") - 1, 0, len(middle) - 1)
        np.minimum.at(low, place, values[good])
        np.maximum.at(high, place, values[good])
        count = np.bincount(place, minlength=len(middle))
        total = np.bincount(place, values[good], minlength=len(middle))
        means[i] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    known = np.isfinite(low)
    table = np.array(list(means.values()))[:, known]
    most_low, median, most_high = np.nanpercentile(table, (10, 50, 90), axis=0)
    named = {i: mean[known] for i, mean in means.items()}
    return Band(middle[known], low[known], high[known], most_low, most_high, median, named)


def outliers(panels: Sequence[Band], log: bool) -> list[int]:
    """The vehicles that are farthest from the median on average over time and panels, the worst first. With `log`, of
    errors on a logarithmic axis, only more than the median counts, by its factor.
    """
    score: dict[int, float] = {}
    for one in panels:
        off = {}
        for i, mean in one.means.items():
            if log:
                away = np.maximum(np.log10(np.maximum(mean, SMALLEST) / np.maximum(one.median, SMALLEST)), 0.0)
            else:
                away = np.abs(mean - one.median)
            known = away[np.isfinite(away)]
            off[i] = float(known.mean()) if len(known) else 0.0
        most = max(off.values(), default=0.0) or 1.0
        for i, value in off.items():
            score[i] = score.get(i, 0.0) + value / most
    return sorted(score, key=lambda i: (-score[i], i))[:NAMED]


def draw_band(ax: Axes, found: Band, colour: str = BAND, style: Any = "-") -> None:
    """The band of all vehicles, that of most, and the median."""
    ax.fill_between(found.t, found.low, found.high, color=colour, alpha=_ALL, linewidth=0, gid="band-all")
    ax.fill_between(found.t, found.most_low, found.most_high, color=colour, alpha=_MOST, linewidth=0, gid="band-most")
    ax.plot(found.t, found.median, color=colour, linestyle=style, linewidth=NORMAL, gid="median")


def vehicle_colours(named: Iterable[int]) -> dict[int, str]:
    """The colour of each of a few vehicles: its own, the same in all pictures, or the next one if that is taken."""
    found: dict[int, str] = {}
    for i in sorted(named):
        own = (i - 1) % len(COLOURS)
        found[i] = next(colour for colour in (*COLOURS[own:], *COLOURS) if colour not in found.values())
    return found


def _outlier_styles(named: Sequence[int]) -> dict[int, dict[str, Any]]:
    colours = vehicle_colours(named)
    return {i: {"color": colours[i], "linestyle": STYLES[k + 1], "linewidth": THIN} for k, i in enumerate(named)}


def band_legend(vehicles: int, named: Sequence[int]) -> list[Artist]:
    return [
        Line2D([], [], color=BAND, linewidth=NORMAL, label=f"median of {vehicles}"),
        Patch(color=BAND, alpha=_ALL + _MOST, linewidth=0, label="10 to 90 %"),
        Patch(color=BAND, alpha=_ALL, linewidth=0, label="all"),
        *(Line2D([], [], label=f"UUV {i}", **style) for i, style in _outlier_styles(named).items()),
    ]


COLUMNS = 90  # of an axis, each about 2 pt wide: two lines beside each other cover it
_TURNS = 2  # in a column: a whole oscillation
_NEAR = 5  # columns; where most of so many have such turns, the signal oscillates and does not only jump
_LEAST = 0.03  # of the range of the axis: what a column's range must be, so that small noise stays a line


class Envelope(NamedTuple):
    """Where a signal oscillates too fast to be seen, and what is drawn instead; arrays of one length."""

    t: Array  # edges of columns [s], each twice, NaN where it does not oscillate
    low: Array
    high: Array


def reach(lines: Iterable[Series], log: bool = False) -> float:
    """The range of all lines of an axis, in decades if it is logarithmic."""
    each = [_visible(values[np.isfinite(values)], log) for _, values in lines]
    some = [values for values in each if len(values)]
    return float(max(values.max() for values in some) - min(values.min() for values in some)) if some else 0.0


def split_envelope(
    t: Array, values: Array, span: tuple[float, float], whole: float, log: bool = False
) -> tuple[Series, Envelope | None]:
    """The line of a signal over time, and the envelope where it oscillates faster than a picture can show, or None.

    There the line is the mean, and the envelope stands in place of a solid block. `t` ascends [s], with NaN in gaps.
    `span` is the time axis [s], `whole` the `reach` of all its lines.
    """
    if len(t) < _TURNS * 2:
        return (t, values), None
    good = np.flatnonzero(np.isfinite(t) & np.isfinite(values) & (t >= span[0]) & (t <= span[1]))
    if len(good) <= COLUMNS * _TURNS:
        return (t, values), None
    edges = np.linspace(*span, COLUMNS + 1)
    place = np.clip(np.searchsorted(edges, t[good], "right") - 1, 0, COLUMNS - 1)
    seen = _visible(values[good], log)
    low, high = np.full(COLUMNS, np.inf), np.full(COLUMNS, -np.inf)
    np.minimum.at(low, place, seen)
    np.maximum.at(high, place, seen)
    steps = np.diff(seen)
    moving = np.flatnonzero(steps)
    turning = moving[1:][np.sign(steps[moving[1:]]) != np.sign(steps[moving[:-1]])]
    turns = np.bincount(place[turning], minlength=COLUMNS)
    fast = (turns >= _TURNS) & (high - low >= _LEAST * whole) & (whole > 0.0)
    fast = (np.convolve(fast, np.ones(_NEAR), "same") > _NEAR / 2) & np.isfinite(low)
    if not fast.any():
        return (t, values), None
    count = np.maximum(np.bincount(place, minlength=COLUMNS), 1)
    mean = np.bincount(place, values[good], minlength=COLUMNS) / count
    of_fast = np.zeros(len(t), bool)
    of_fast[good[fast[place]]] = True
    middle = (edges[1:] + edges[:-1])[fast] / 2
    # Where its samples were in the order of the line, so that gaps stay gaps.
    first = np.searchsorted(place, np.flatnonzero(fast))
    kept = ~of_fast
    order = np.argsort(np.concatenate([np.flatnonzero(kept), good[first]]), kind="stable")
    line = np.concatenate([t[kept], middle])[order], np.concatenate([values[kept], mean[fast]])[order]
    bottom, top = np.full(COLUMNS, np.inf), np.full(COLUMNS, -np.inf)
    np.minimum.at(bottom, place, values[good])
    np.maximum.at(top, place, values[good])
    shape = [np.repeat(np.where(fast, one, np.nan), 2) for one in (bottom, top)]
    return line, Envelope(np.repeat(edges, 2)[1:-1], *shape)


def _visible(values: Array, log: bool) -> Array:
    return np.log10(np.maximum(np.abs(values), SMALLEST)) if log else values


MOST_NAMED = len(COLOURS)  # lines that a legend names; more vehicles are a band
_MOST_LINES = 12  # of several runs that have the colours of vehicles
FEW = 60  # samples that are shown as points too

_RUN = 18  # characters of a run behind a fault

Get = Callable[[LoggedRun, int], tuple[Array, Array] | None]


def time_axes(
    rows: int, runs: Sequence[LoggedRun], view: View, height: float | None = None, ratios: Sequence[float] | None = None
) -> tuple[Figure, list[Axes]]:
    """Axes above each other that share the time axis, at column width."""
    figure, axes = panels(rows, 1, column_in(), height or 1.3 * rows + 0.8, ratios)
    axes[0].set_xlim(time_span(runs, view))
    return figure, axes


def time_span(runs: Sequence[LoggedRun], view: View) -> tuple[float, float]:
    """The time that is shown [s]."""
    return view.window or (min(run.log.begin for run in runs), max(run.log.end for run in runs) or 1.0)


def finish(
    figure: Figure, axes: Sequence[Axes], runs: Sequence[LoggedRun], notes: Sequence[str] = (), columns: int = 1
) -> None:
    """Shade the faults, name them above the first axis, label the time axis and put the words below everything.

    `columns`: how many axes stand beside each other.
    """
    named = _shade(axes, runs)
    lines = [*named, *draw_failures(axes, runs), *notes]
    for run in runs:
        if run.log.missing:
            whose = f"{run.label}: " if len(runs) > 1 else ""
            lines.append(f"{whose}the log is not whole, it ends at {run.log.end:g} s")
    for ax in axes[-columns:]:
        ax.set_xlabel("time [s]")
    rows = {text.xyann[1] for text in axes[0].texts if isinstance(text, Annotation) and text.get_gid() == "fault-name"}
    for ax in axes[:columns]:
        if ax.get_title():
            ax.set_title(ax.get_title(), pad=4.0 + len(rows) * (label_pt() + 3.0))
    _grow(figure, label_pt() * len(rows))
    write_caption(figure, lines)
    figure.align_ylabels(list(axes))


def draw_lines(
    figure: Figure,
    panel: Sequence[tuple[Axes, Get]],
    runs: Sequence[LoggedRun],
    view: View,
    log: bool = False,
    exact: bool = False,
    apart: bool = False,
    **style: Any,
) -> list[str]:
    """Draw one line per vehicle into each panel, axes with the function that gets their signal, in the vehicle's colour
    or in the run's; many vehicles make a band. Returns words on vehicles that have no such signal.

    `log`: the signals are errors on a logarithmic axis, on which outliers are chosen. `exact`: the line goes through
    every sample, also if a signal oscillates too fast to be seen. `apart`: each vehicle has panels of its own, whose
    colour is that of the run. Raises NothingToDraw if no vehicle has it.
    """
    by_run = len(runs) > 1
    own = {} if apart and by_run else colours_of_vehicles(runs, view)
    each = [[_series(run, view, get) for _, get in panel] for run in runs]
    if not any(signals for found in each for signals in found):
        if not any(run.vehicles(view) for run in runs):
            raise NothingToDraw("the log has no such vehicle" if view.vehicles else "the log has no vehicles")
        raise NothingToDraw("no vehicle reports it")
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
            styles = {i: of_run | {"linewidth": THIN} | ({"color": own[i]} if own else {}) for i in reported}
        else:
            dashes: Sequence[Any] = ["-"] * len(vehicles) if apart else STYLES
            styles = {i: {"color": own[i], "linestyle": dashes[k]} for k, i in enumerate(vehicles) if i in reported}
            styles = {i: look | ({"linewidth": THIN} if apart else {}) for i, look in styles.items()}
            entries = [Line2D([], [], label=run.vehicle_label(i), **one) for i, one in styles.items()]
        for (ax, _), signals in zip(panel, found, strict=True):
            whole = 0.0 if exact else reach(signals.values(), log)
            for i in sorted(signals.keys() & styles.keys()):
                too_fast |= _draw_line(ax, f"{run.slug}-vehicle-{i}", signals[i], whole, log, styles[i] | style)
        if silent := [i for i in vehicles if i not in reported]:
            notes.append(f"{run.label + ': ' if by_run else ''}not reported by UUV {first_words(silent)}")
    if too_fast:
        notes.append("shading: range of a fast oscillation; line: its mean")
    if by_run:
        marks_legend(figure, entries_of_runs(runs, own))
    elif len(entries) > 1 and not apart:
        marks_legend(figure, entries)
    return notes


def _draw_bands(
    axes: Sequence[Axes], found: Sequence[Mapping[int, Series]], style: dict[str, Any], log: bool, *, name: bool
) -> tuple[dict[int, dict[str, Any]], list[Artist]]:
    """A band of the many vehicles of a run on each axis; returns the style of the line of each outlier, and the entries
    of the legend. `name`: whether outliers are drawn and named.
    """
    spreads = [spread(signals) if signals else None for signals in found]
    for ax, one in zip(axes, spreads, strict=True):
        if one is not None:
            draw_band(ax, one, BAND if name else style["color"], style["linestyle"])
    named = outliers([one for one in spreads if one is not None], log) if name else []
    reported = {i for signals in found for i in signals}
    return _outlier_styles(named), band_legend(len(reported), named)


def colours_of_vehicles(runs: Sequence[LoggedRun], view: View) -> dict[int, str]:
    """The colour of each vehicle. Empty: there are too many lines; then those of several runs have the run's colour."""
    vehicles = sorted({i for run in runs for i in run.vehicles(view)})
    most = MOST_NAMED if len(runs) == 1 else min(MOST_NAMED, _MOST_LINES // len(runs))
    return vehicle_colours(vehicles) if len(vehicles) <= most else {}


def entries_of_runs(runs: Sequence[LoggedRun], colours: Mapping[int, str]) -> list[Artist]:
    """Entries of a legend: each vehicle by its colour, and each run by its dashes. A word names the dashes, because a
    short sample of them shows little.
    """
    labels = {i: next(run.vehicle_label(i) for run in runs if i in run.log.vehicles) for i in colours}
    of_vehicles = [Line2D([], [], color=colour, label=labels[i]) for i, colour in colours.items()]
    looks = zip(runs, cycle(STYLE_NAMES), cycle(COLOURS), cycle(STYLES), strict=False)
    of_runs = [
        Line2D([], [], color="black" if colours else colour, linestyle=style, label=f"{name}: {run.label}")
        for run, name, colour, style in looks
    ]
    return [*(of_vehicles if len(of_vehicles) > 1 else []), *of_runs]


def _draw_line(ax: Axes, gid: str, series: Series, whole: float, log: bool, style: dict[str, Any]) -> bool:
    """Draw the line of a vehicle, or its envelope if it oscillates too fast. Returns whether it is the envelope."""
    first, last = ax.get_xlim()
    (t, values), around = split_envelope(*series, (first, last), whole, log)
    if around is not None:
        ax.fill_between(
            around.t,
            around.low,
            around.high,
            facecolor=to_rgba(style["color"], 0.08),
            edgecolor=style["color"],
            linewidth=0.3,
            gid=f"{gid}-envelope",
        )
        style = style | {"drawstyle": "default"}  # means are not held
    ax.plot(t, values, gid=gid, marker="." if len(t) < FEW else "", markersize=3, **style)
    return around is not None


def _series(run: LoggedRun, view: View, get: Get) -> dict[int, Series]:
    found = {i: get(run, i) for i in run.vehicles(view)}
    return {i: clip_to_window(*one, view.window) for i, one in found.items() if one is not None}


def clip_to_window(t: Array, values: Array, window: tuple[float, float] | None) -> Series:
    """The samples in a window, and one before and one behind it, so that a line reaches the edges."""
    if window is None:
        return t, values
    before, behind = np.flatnonzero(t <= window[0]), np.flatnonzero(t >= window[1])
    part = slice(before[-1] if len(before) else 0, behind[0] + 1 if len(behind) else len(t))
    return t[part], values[part]


def legend_of(figure: Figure, entries: Sequence[tuple[str, Any, Any]]) -> None:
    marks_legend(figure, [Line2D([], [], color=c, linestyle=style, label=label) for label, c, style in entries])


def marks_legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """One legend above all axes, in as few rows as fit."""
    size = legend_pt()
    widths = [4.0 * size + text_width_pt(str(handle.get_label()), size) for handle in handles]  # pt

    def needed(columns: int) -> float:
        rows = -(-len(widths) // columns)  # a legend is filled column by column
        return sum(max(widths[k : k + rows]) for k in range(0, len(widths), rows))

    fitting = next((n for n in range(len(widths), 1, -1) if needed(n) <= 72.0 * figure.get_figwidth()), 1)
    fitting = -(-len(widths) // -(-len(widths) // fitting))  # rows of about the same length
    _grow(figure, legend_pt() * (-(-len(widths) // fitting) - 1))
    found = figure.legend(
        handles=list(handles), loc="outside upper center", ncols=fitting,
        columnspacing=1.0, handlelength=1.8, handletextpad=0.5,
    )  # fmt: skip
    for text in found.get_texts():
        text.set_parse_math(False)  # names of strangers


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
        limit(ax, value)
    if near:
        room = 0.06 * (max(high, *near) - min(low, *near))  # so that a bound is not the frame
        ax.set_ylim(min(low, near[0] - room), max(high, near[-1] + room))
    far = ", ".join(f"{value:g}" for value in limits if value not in near)
    return f"outside: {what}, {far} {unit}" if far else ""


def _with_runs(fault: FaultInterval, labels: Sequence[str]) -> FaultInterval:
    only = labels[0] if len(labels[0]) <= _RUN else f"…{labels[0][1 - _RUN :]}"  # the end tells runs apart
    of = f" ({only if len(labels) == 1 else f'{len(labels)} runs'})"
    what = fault.what if not fault.is_fault else words(fault, MOST_CHARACTERS - len(of))
    return fault._replace(id="f0", what=f"{what}{of}")


def _shade(axes: Sequence[Axes], runs: Sequence[LoggedRun]) -> list[str]:
    whose: dict[FaultInterval, list[str]] = {}
    for run in runs:
        for fault in (*run.log.faults, *run.log.events):
            whose.setdefault(fault, []).append(run.label)
    # A fault that not every run had is named with those that had it, which are never cut off.
    called = [fault if len(labels) == len(runs) else _with_runs(fault, labels) for fault, labels in whose.items()]
    return shade(axes, called)
