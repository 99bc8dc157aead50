"""What the pictures over time have in common: lines by vehicle or by run, shaded faults, one legend, words below."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fleet.logs.open_log import FaultInterval
from fleet.logs.records import Array
from fleet.palette import COLOURS
from fleet.pictures.runs import NothingToDraw, Run, View, first_words
from fleet.pictures.style import COLUMN_IN, STYLES, panels
from fleet.scenario.sections.timeline import is_fault

LABEL_PT = 6.0
LABEL_ROWS = 6  # of names of faults; what does not fit there is shaded without its name
SPAN_IN = 2.7  # width of a time axis, about
MOST_NAMED = len(COLOURS)  # lines that a legend names; more are distinguished by a colour bar
TUMBLE = "#c0392b"
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


def finish(figure: Figure, axes: Sequence[Axes], runs: Sequence[Run], view: View, notes: Sequence[str] = ()) -> None:
    """Shade the faults, name them above the first axis, label the time axis and put the words below it."""
    _shade(axes, runs, view)
    lines = [*notes, *(_cut(run, len(runs)) for run in runs if run.log.missing)]
    axes[-1].set_xlabel("\n".join(["time [s]", *lines]))
    figure.align_ylabels(list(axes))


def _cut(run: Run, runs: int) -> str:
    return f"{run.label + ': ' if runs > 1 else ''}the log is not whole, it ends at {run.log.end:g} s"


def colours(number: int) -> list[Any]:
    """So many colours that can be distinguished: the palette's, or steps from dark to light."""
    if number <= MOST_NAMED:
        return list(COLOURS[:number])
    return [colormaps["viridis"](k / (number - 1) * 0.92) for k in range(number)]


def draw_lines(
    figure: Figure, panel: Sequence[tuple[Axes, Get]], runs: Sequence[Run], view: View, whose: str = ""
) -> list[str]:
    """One line per vehicle and panel, its colour the vehicle's; of several runs, the run's.

    Args:
        whose: which laws report such a signal, for the message if no vehicle does.

    Returns:
        words on vehicles that have no such signal.

    Raises:
        NothingToDraw: no vehicle has it.
    """
    shown = sorted({i for run in runs for i in run.vehicles(view)})
    by_run = len(runs) > 1
    palette = colours(len(runs) if by_run else len(shown))
    silent: dict[str, list[int]] = {}
    drawn: set[int] = set()
    for r, run in enumerate(runs):
        for i in run.vehicles(view):
            k = r if by_run else shown.index(i)
            found = False
            for ax, get in panel:
                got = get(run, i)
                if got is None:
                    continue
                found = True
                t, values = got
                many = len(palette) > MOST_NAMED or by_run
                ax.plot(
                    t,
                    values,
                    color=palette[k],
                    linestyle=STYLES[k % len(STYLES)] if len(palette) <= MOST_NAMED else "-",
                    linewidth=0.7 if many else 1.0,
                    marker="." if len(t) < FEW else "",
                    markersize=3,
                    label=f"UUV {i}",
                    gid=f"{run.slug}-vehicle-{i}",
                )
            if found:
                drawn.add(k)
            else:
                silent.setdefault(run.label, []).append(i)
    if not drawn:
        if not shown:
            raise NothingToDraw("the log has no such vehicle" if view.vehicles else "the log has no vehicles")
        raise NothingToDraw(f"no vehicle reports it{f': {whose}' if whose else ''}")
    if by_run:
        legend_of(figure, [(run.label, palette[r], STYLES[r % len(STYLES)]) for r, run in enumerate(runs)])
    elif len(shown) <= MOST_NAMED:
        if len(shown) > 1:
            legend_of(figure, [(f"UUV {i}", palette[k], STYLES[k]) for k, i in enumerate(shown) if k in drawn])
    else:
        vehicle_bar(figure, [ax for ax, _ in panel], shown)
    return [f"{label + ': ' if by_run else ''}not reported by UUV {first_words(who)}" for label, who in silent.items()]


def legend_of(figure: Figure, entries: Sequence[tuple[str, Any, Any]]) -> None:
    """One legend of lines above all axes."""
    marks_legend(figure, [Line2D([], [], color=c, linestyle=style, label=label) for label, c, style in entries])


def marks_legend(figure: Figure, handles: Sequence[Line2D]) -> None:
    """One legend above all axes, in as few rows as fit."""
    widths = [22.0 + 4.1 * len(str(handle.get_label())) for handle in handles]  # pt

    def needed(columns: int) -> float:
        rows = -(-len(widths) // columns)  # a legend is filled column by column
        return sum(max(widths[k : k + rows]) for k in range(0, len(widths), rows))

    fitting = next((n for n in range(len(widths), 1, -1) if needed(n) <= 72.0 * COLUMN_IN), 1)
    fitting = -(-len(widths) // -(-len(widths) // fitting))  # rows of about the same length
    figure.legend(
        handles=list(handles), loc="outside upper center", ncols=fitting,
        columnspacing=1.0, handlelength=1.8, handletextpad=0.5,
    )  # fmt: skip


def vehicle_bar(figure: Figure, axes: Sequence[Axes], vehicles: Sequence[int]) -> None:
    """A bar of colours in place of a legend with too many lines."""
    norm = BoundaryNorm(np.arange(len(vehicles) + 1) - 0.5, len(vehicles))
    mapped = ScalarMappable(norm, ListedColormap(colours(len(vehicles))))
    bar = figure.colorbar(mapped, ax=list(axes), location="top", aspect=45, pad=0.02, fraction=0.06)
    every = max(1, round(len(vehicles) / 10))
    bar.set_ticks(
        list(range(0, len(vehicles), every)), labels=[str(vehicles[k]) for k in range(0, len(vehicles), every)]
    )
    bar.set_label("UUV", labelpad=2)
    bar.ax.tick_params(length=0, which="both")
    bar.outline.set_linewidth(0.4)


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


def _shade(axes: Sequence[Axes], runs: Sequence[Run], view: View) -> None:
    whose: dict[FaultInterval, list[str]] = {}
    for run in runs:
        for fault in run.log.faults:
            whose.setdefault(fault, []).append(run.label)
    # A fault that not every run had is named with those that had it.
    called = [
        fault if len(labels) == len(runs) else fault._replace(id=f"{fault.id} ({', '.join(labels)})")
        for fault, labels in whose.items()
    ]
    shade(axes, called)


def shade(axes: Sequence[Axes], intervals: Sequence[FaultInterval]) -> None:
    """Grey where a fault lasts, red where a vehicle is tumbled, with names above the first axis."""
    spans = sorted(intervals, key=lambda f: (f.begin, f.end, f.id))
    first, last = axes[0].get_xlim()
    spans = [f for f in spans if f.begin < last and f.end > first]
    for ax in axes:
        for span in spans:
            colour, alpha = ("0.45", 0.2) if is_fault(span.what) else (TUMBLE, 0.12)
            ax.axvspan(span.begin, span.end, color=colour, alpha=alpha, linewidth=0, zorder=0, gid=f"fault-{span.id}")
    named = [f for f in spans if is_fault(f.what)]
    # A vehicle that tumbles again and again is named once, where it first did.
    again: dict[str, list[FaultInterval]] = {}
    for span in spans:
        if not is_fault(span.what):
            again.setdefault(span.what, []).append(span)
    for what, all_of_it in again.items():
        times = f" ({len(all_of_it)} times)" if len(all_of_it) > 1 else ""
        named.append(all_of_it[0]._replace(id=f"{what}{times}"))
    _name(axes[0], sorted(named, key=lambda f: (f.begin, f.end, f.id)), first, last)


def _rows(
    faults: Sequence[FaultInterval], texts: Sequence[str], first: float, last: float
) -> list[tuple[str, float, int]]:
    """(text, where it begins [s], row from below) of those that find room."""
    per_character = 0.62 * LABEL_PT / 72.0 / SPAN_IN * (last - first)
    rows: list[float] = []  # until where each is taken
    placed = []
    for fault, text in zip(faults, texts, strict=True):
        width = (len(text) + 1) * per_character
        begin = max(min(max(fault.begin, first), last - width), first)
        row = next((k for k, taken in enumerate(rows) if taken <= begin), len(rows))
        if row < LABEL_ROWS:
            rows[row : row + 1] = [begin + width]
            placed.append((text, begin, row))
    return placed


def _name(ax: Axes, faults: Sequence[FaultInterval], first: float, last: float) -> None:
    """Each fault's id above the axis where it begins, in as many rows as are needed so that none covers another."""
    texts = [fault.id if len(fault.id) <= 32 else f"{fault.id[:31]}…" for fault in faults]
    placed = _rows(faults, texts, first, last)
    if len(placed) < len(faults):  # rather without the runs that they belong to than not at all
        placed = _rows(faults, [text.split(" (")[0] for text in texts], first, last)
    for text, begin, row in placed:
        ax.annotate(
            text,
            (begin, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2.0 + row * (LABEL_PT + 1.0)),
            textcoords="offset points",
            fontsize=LABEL_PT,
            color="0.25",
            annotation_clip=False,
            gid="fault-name",
        )
