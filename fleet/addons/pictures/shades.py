"""Faults on a time axis: where one lasts is shaded once, and what it was stands above, each over its own time.

Events of vehicles are shaded, too. Each vehicle's have one line below, because they follow from the faults.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import ScaledTranslation

from fleet.addons.pictures.caption import text_width_pt
from fleet.addons.pictures.look import label_pt
from fleet.addons.pictures.style import THIN
from fleet.scenario.sections.timeline import FaultInterval
from fleet.scenario.sections.vehicle_events import vehicle_events

Span = tuple[float, float]

TUMBLE = "#c0392b"
_NAME = "0.25"
MOST_ROWS = 5  # of words above an axis; faults that need more are numbered
MOST_CHARACTERS = 34
_MOST_LISTED = 12  # numbers that are explained
_MOST_EVENTS = 5  # vehicles whose tumbles have a line
_GIVEN = re.compile(r"(f\d+|nemesis-\d+(-\d+)?|broken-\d+)$")  # ids that nobody chose


def shade(axes: Sequence[Axes], intervals: Sequence[FaultInterval]) -> list[str]:
    """Grey where a fault lasts, in words above the first axis; red where a vehicle is tumbled. Returns lines that
    explain the numbers, if there are too many faults for words, and one for each vehicle that tumbled.
    """
    first, last = axes[0].get_xlim()
    spans = sorted((f for f in intervals if f.begin < last and f.end > first), key=lambda f: (f.begin, f.end, f.id))
    faults = [f for f in spans if f.is_fault]
    others = [f for f in spans if not f.is_fault]
    for ax in axes:
        for some, colour, alpha, gid in ((faults, "0.45", 0.2, "fault"), (others, TUMBLE, 0.18, "tumbled")):
            for begin, end in union([(f.begin, f.end) for f in some]):
                ax.axvspan(begin, end, color=colour, alpha=alpha, linewidth=0, zorder=0, gid=gid)
    rows = vehicle_events((f.what, f.begin) for f in others)
    listed = [str(row) for row in rows[:_MOST_EVENTS]]
    if len(rows) > _MOST_EVENTS:
        listed.append(f"and {len(rows) - _MOST_EVENTS} more vehicles")
    return [*_name(axes[0], faults, first, last), *listed]


def union(spans: Sequence[Span]) -> list[Span]:
    """The same time as spans that do not overlap, in order."""
    found: list[Span] = []
    for begin, end in sorted(spans):
        if found and begin <= found[-1][1]:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((begin, end))
    return found


def words(fault: FaultInterval, most: int = MOST_CHARACTERS) -> str:
    """A fault in words, behind its id if somebody chose that."""
    text = fault.what if _GIVEN.match(fault.id) or not fault.what else f"{fault.id}: {fault.what}"
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _rows(
    faults: Sequence[FaultInterval], texts: Sequence[str], first: float, last: float, per_pt: float
) -> list[int] | None:
    """The row of each text, from below, so that none covers another or another's line; None: it takes too many."""
    taken: list[float] = []  # until where each row is
    rows = []
    for fault, text in zip(faults, texts, strict=True):
        width = (text_width_pt(text, label_pt()) + 4.0) * per_pt
        begin = _text_left_s(fault, width, first, last)
        row = next((k for k, until in enumerate(taken) if until <= begin), len(taken))
        if row >= MOST_ROWS:
            return None
        taken[row : row + 1] = [max(begin + width, min(fault.end, last))]
        rows.append(row)
    return rows


def _text_left_s(fault: FaultInterval, width: float, first: float, last: float) -> float:
    """Where the text of a fault begins [s]: with the fault, but inside."""
    return max(min(max(fault.begin, first), last - width), first)


def _name(ax: Axes, faults: Sequence[FaultInterval], first: float, last: float) -> list[str]:
    listed: list[str] = []
    if not faults:
        return []
    per_pt = (last - first) / width_pt(ax)
    texts = [words(fault) for fault in faults]
    rows = _rows(faults, texts, first, last, per_pt)
    if rows is None:
        listed = _list_lines(texts)
        texts = [str(number + 1) for number in range(len(faults))]
        rows = _rows(faults, texts, first, last, per_pt)
    if rows is None:
        return [f"{len(faults)} faults, too many to name"]
    for fault, text, row in zip(faults, texts, rows, strict=True):
        width = (text_width_pt(text, label_pt()) + 4.0) * per_pt
        above = 2.0 + row * (label_pt() + 3.0)
        ax.annotate(
            text, (_text_left_s(fault, width, first, last), 1.0), xycoords=("data", "axes fraction"),
            xytext=(0, above + 1.0), textcoords="offset points", fontsize=label_pt(), color=_NAME,
            annotation_clip=False, gid="fault-name", parse_math=False,
        )  # fmt: skip
        raised = ScaledTranslation(0.0, above / 72.0, _figure(ax).dpi_scale_trans)
        extent = [max(fault.begin, first), min(fault.end, last)]
        ax.add_artist(
            Line2D(extent, [1.0, 1.0], color=_NAME, linewidth=THIN, clip_on=False, gid="fault-time",
                   transform=ax.get_xaxis_transform() + raised)
        )  # fmt: skip
    return listed


def _list_lines(texts: Sequence[str]) -> list[str]:
    """Lines such as `1 kill 3, 2 deaf 1`, short enough for a column."""
    named = [f"{number} {text}" for number, text in enumerate(texts[:_MOST_LISTED], 1)]
    if len(texts) > _MOST_LISTED:
        named.append(f"and {len(texts) - _MOST_LISTED} more")
    lines = [""]
    for text in named:
        if lines[-1] and len(lines[-1]) + len(text) > 46:
            lines.append("")
        lines[-1] += f"; {text}" if lines[-1] else text
    return lines


def width_pt(ax: Axes) -> float:
    """The width of an axis [pt] as the layout makes it."""
    figure = _figure(ax)
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
    return float(ax.get_position().width * figure.get_size_inches()[0] * 72.0)


def _figure(ax: Axes) -> Figure:
    figure = ax.get_figure(root=True)
    assert figure is not None
    return figure
