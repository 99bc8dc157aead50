"""The fate of the packets of each link over time: a strip per link with the share of every fate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fleet.addons.pictures.axes import (
    finish,
    marks_legend,
    time_axes,
)
from fleet.addons.pictures.exchange import FATES, fates_of, links_between, name_rows, rank
from fleet.addons.pictures.look import label_pt
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View
from fleet.logs.payload_kinds import DAMAGED, count_kinds
from fleet.logs.topic_names import link_topic
from fleet.mcap.records import Array
from netem.cause import Cause
from netem.condition import Link

MOST_ROWS = 36  # links with a row of their own; of more, the worst have one, and the others one together
WORST = 12
LATE = "late"  # arrived, but behind a newer packet of its link
_ARRIVED = (Cause.DELIVERED, LATE)
_COLOURS = {LATE: "#0072B2"} | {fate: colour for fate, (_, colour) in FATES.items()}
_BINS = 150  # of the time axis, at most
_PER_BIN = 4  # packets, if there are enough
_ROW_IN = 0.17
_MOST_KINDS = 6


@dataclass(slots=True)
class ShareRow:
    """A strip of the picture: one link, or several together."""

    name: str
    bins: dict[str, Array] = field(default_factory=dict)  # fate -> packets in each bin

    @property
    def total(self) -> int:
        return int(sum(counts.sum() for counts in self.bins.values()))

    @property
    def arrived(self) -> float:
        """The share of the packets that arrived whole; 1 without packets."""
        good = sum(counts.sum() for fate, counts in self.bins.items() if fate in _ARRIVED)
        return float(good / self.total) if self.total else 1.0


def timeline(runs: Sequence[LoggedRun], view: View) -> Figure:
    """A strip per link: the shares of its packets' fates by sending time, exact where a fault begins or ends."""
    (run,) = runs
    links = links_between(run, view)
    first, last = view.window or (0.0, run.log.end or 1.0)
    found = {link: _fates_between(run, link, first, last) for link in links}
    sent = [times for times, _ in found.values() if len(times)]
    if not sent:
        raise NothingToDraw("no packet was sent in that time")
    faults = [edge for fault in run.log.faults for edge in (fault.begin, fault.end)]
    edges = time_bins(first, last, faults, _period(sent))
    rows = fold([ShareRow(run.link_label(link), _count(*found[link], edges)) for link in links])
    height = float(np.clip(_ROW_IN * len(rows), min(0.3 * len(rows), 1.6), 7.0))
    figure, (ax,) = time_axes(1, runs, view, height + 1.2)
    counts: Counter[str] = Counter()
    for row in rows:
        counts.update({fate: int(bins.sum()) for fate, bins in row.bins.items()})
    shown = sorted(counts, key=_order)
    for fate, polygons in strips(rows, shown, edges).items():
        ax.add_collection(
            PolyCollection(polygons, facecolor=_colour(fate), linewidth=0, antialiased=False, zorder=2,
                           gid=f"fate-{fate}")
        )  # fmt: skip
    ax.set_ylim(len(rows) - 0.4, -0.6)
    name_rows(ax, [row.name for row in rows], label_pt())
    for k, row in enumerate(rows):
        share = f"{100.0 * row.arrived:.3g} %" if row.total else "none"
        ax.annotate(share, (1.0, k), xycoords=("axes fraction", "data"), xytext=(2, 0), textcoords="offset points",
                    fontsize=label_pt() - 0.5, va="center", color="0.25", gid="arrived")  # fmt: skip
    ax.set_ylabel("link")
    ax.grid(False)
    marks_legend(figure, [Patch(color=_colour(fate), label=f"{fate} {counts[fate]}") for fate in shown])
    notes = ["right: share that arrived"]
    if any((sum(row.bins.values(), np.zeros(len(edges) - 1)) == 0).any() for row in rows):
        notes.append("blank: nothing was sent")
    if LATE in counts:
        notes.append("late: arrived behind a newer one of its link")
    if view.window is None:
        notes += kinds_line(run, links)
    finish(figure, [ax], runs, notes)
    return figure


def kinds_line(run: LoggedRun, links: Sequence[Link]) -> list[str]:
    """Words on how many packets carried which kind of payload, and how many of these arrived; none if all are alike."""
    kinds = count_kinds(run.log[link_topic(link)] for link in links) or []
    if len([one for one in kinds if one.kind != DAMAGED]) < 2:
        return []
    each = [f"{one.kind} {one.packets} ({one.delivered / one.packets:.0%} whole)" for one in kinds[:_MOST_KINDS]]
    more = [f"{len(kinds) - _MOST_KINDS} more kinds"] if len(kinds) > _MOST_KINDS else []
    return ["kinds: " + ", ".join(each + more)]


def fold(rows: list[ShareRow]) -> list[ShareRow]:
    """The rows as they are, or of too many the worst by what arrived, worst first, and one for all others."""
    if len(rows) <= MOST_ROWS:
        return rows
    best = max(row.arrived for row in rows)
    worst = sorted((row for row in rows if row.arrived < best), key=lambda row: row.arrived)[:WORST]
    own = set(map(id, worst))
    others = [row for row in rows if id(row) not in own]
    together: dict[str, Array] = {}
    for row in others:
        for fate, counts in row.bins.items():
            together[fate] = together.get(fate, 0) + counts
    return [*worst, ShareRow(f"{len(others)} others" if worst else f"all {len(others)}", together)]


def time_bins(first: float, last: float, faults: Sequence[float], period: float) -> Array:
    """Edges [s] of bins of about the same width, with an edge exactly where a fault begins or ends."""
    span = last - first
    width = max(span / _BINS, min(_PER_BIN * period, span / 20.0), period)
    corners = sorted({first, last, *(edge for edge in faults if first < edge < last)})
    parts = [np.linspace(a, b, max(1, int((b - a) / width)) + 1)[:-1] for a, b in pairwise(corners)]
    return np.append(np.concatenate(parts), last)


def strips(rows: Sequence[ShareRow], fates: Sequence[str], edges: Array) -> dict[str, list[Array]]:
    """Fate -> a polygon (points, 2) per row: [s] and place; the shares of a bin upon one another."""
    x = np.repeat(edges, 2)[1:-1]
    found: dict[str, list[Array]] = {}
    for k, row in enumerate(rows):
        total = np.maximum(sum(row.bins.values(), np.zeros(len(edges) - 1)), 1)
        below = np.full(len(edges) - 1, k + 0.4)
        for fate in fates:
            if fate not in row.bins:
                continue
            above = below - 0.8 * row.bins[fate] / total
            outline = np.concatenate([np.repeat(below, 2), np.repeat(above, 2)[::-1]])
            found.setdefault(fate, []).append(np.column_stack([np.concatenate([x, x[::-1]]), outline]))
            below = above
    return found


def _fates_between(run: LoggedRun, link: Link, first: float, last: float) -> tuple[Array, Array]:
    """(sent [s], fate) of the packets of a link that were sent in a time; what was overtaken is late."""
    sent, due, fate, _ = fates_of(run, link)
    good = np.flatnonzero(fate == Cause.DELIVERED)
    order = good[np.lexsort((sent[good], due[good]))]
    newest = np.maximum.accumulate(sent[order]) if len(order) else sent[order]
    fate = fate.copy()
    fate[order[sent[order] < newest]] = LATE
    inside = (sent >= first) & (sent <= last)
    return sent[inside], fate[inside]


def _count(sent: Array, fate: Array, edges: Array) -> dict[str, Array]:
    # A tick is a multiple of a float that is none: what is sent where a fault begins is sent in it.
    place = np.clip(np.searchsorted(edges, sent + 1e-9, "right") - 1, 0, len(edges) - 2)
    return {name: np.bincount(place[fate == name], minlength=len(edges) - 1) for name in set(fate)}


def _period(sent: Sequence[Array]) -> float:
    """The usual time between two packets of a link [s]."""
    gaps = [np.diff(np.unique(times)) for times in sent]
    together = np.concatenate(gaps)
    return float(np.median(together)) if len(together) else 0.0


def _order(fate: str) -> tuple[int, str]:
    """Fates in their order, delivered first, so that it is at the bottom of a strip."""
    number, name = rank(Cause.DELIVERED if fate == LATE else fate)
    return number, f"{name}, {fate}" if fate == LATE else name


def _colour(fate: str) -> str:
    return _COLOURS.get(fate, "#777777")
