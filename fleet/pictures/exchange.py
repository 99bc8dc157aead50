"""The traffic on the links: fates of packets, ages of information."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from fleet.logs.records import Array
from fleet.logs.topic_names import link_topic
from fleet.palette import COLOURS
from fleet.pictures.axes import finish, legend_of, over_time
from fleet.pictures.runs import NothingToDraw, Run, View
from fleet.pictures.style import LABEL_PT, THIN, plain_decades
from netem.condition import Link
from netem.fault_kinds import Cause

CORRUPTED = "corrupted"
# Fate -> colour: blue for what arrives, grey for what is neither, warm for what is lost; what tends to happen together
# differs in lightness, too.
FATES: dict[str, str] = {
    Cause.DELIVERED: "#56B4E9",
    Cause.IN_FLIGHT: "#777777",
    Cause.REPLACED: "#BBBBBB",  # what an acoustic modem never sends, which is no loss of the channel
    CORRUPTED: "#CC79A7",
    Cause.LOSS: "#D55E00",
    Cause.PARTITION: "#7F1D1D",
    Cause.DOWN: "#E6A100",
    Cause.MUTE: "#F28E2B",
    Cause.QUEUE: "#FDC086",
    Cause.MTU: "#8C6D1F",
    Cause.RANGE: "#F6C700",
    Cause.HALF_DUPLEX: "#FFA07A",
    Cause.COLLISION: "#C51B3A",
    Cause.SNR: "#5B1A0B",
    Cause.DEAD_SENDER: "#A65628",
    Cause.DEAF: "#E7298A",
    Cause.DEAD_RECEIVER: "#4A2C0A",
}
_BINS = 300  # of the time axis of the ages, at most; twice as many where every tooth can be seen
_MOST_NAMED = 36  # rows
_MOST_LINKS = 100  # with a row among the ages; of more, the oldest have one
_ROW_IN = 0.11  # height of a link's row among the ages, enough for its name


def links_between(run: Run, view: View) -> list[Link]:
    """The directed links between the vehicles to show.

    Raises:
        NothingToDraw: there are none, or the log is not one of ours.
    """
    run.tick_s  # noqa: B018  (a foreign log has no packets of ours)
    found = [(a, b) for a, b in run.log.links if view.vehicles is None or (a in view.vehicles and b in view.vehicles)]
    if not found:
        raise NothingToDraw("no links between these vehicles" if run.log.links else "the log has no links")
    return found


def fates_of(run: Run, link: Link) -> tuple[Array, Array, Array]:
    """(sent [s], due [s], fate) of every packet of a link; a corrupted one's fate is `corrupted`."""
    packets = run.log[link_topic(link)]
    if not len(packets):
        return np.empty(0), np.empty(0), np.empty(0, object)
    fate = np.where(packets["corrupted"] & (packets["fate"] == Cause.DELIVERED), CORRUPTED, packets["fate"])
    return packets["sent"], packets["due"], fate.astype(object)


def rank(fate: str) -> tuple[int, str]:
    """The place of a fate in legends, and which lies upon which: as in `FATES`."""
    return (list(FATES).index(fate) if fate in FATES else len(FATES)), fate


def name_rows(ax: Axes, names: Sequence[str], size: float) -> None:
    """Names of rows along the vertical axis, as many as can be read."""
    every = -(-len(names) // _MOST_NAMED)
    ax.set_yticks(range(0, len(names), every), names[::every])
    ax.tick_params(axis="y", length=0, labelsize=size)


def peak_ages(run: Run, link: Link, edges: Array) -> Array:
    """The largest age [s] of information on a link in each interval between two edges [s]: see `netem.ages`.

    Only ticks that were started count; NaN where there is none. The age grows until something newer arrives, so that
    the largest of an interval is at its last tick, or at the tick before an arrival.
    """
    ticks = int(run.log.run.get("ticks", 0))
    count = min(round(run.log.end / run.tick_s) + 1, ticks) if ticks else round(run.log.end / run.tick_s) + 1
    sent, due, fate = fates_of(run, link)
    good = fate == Cause.DELIVERED
    arrived = np.rint(due[good] / run.tick_s).astype(np.int64)
    order = np.argsort(arrived, kind="stable")
    arrived = arrived[order]
    heard = np.maximum.accumulate(np.rint(sent[good] / run.tick_s).astype(np.int64)[order])

    def age(at: Array) -> Array:
        known = np.searchsorted(arrived, at, "right")
        return at - np.where(known > 0, np.append(heard, 0)[known - 1], 0)

    near = np.ceil(edges / run.tick_s)  # the first tick from an edge on, but for a rounding
    near = near - ((near - 1) * run.tick_s >= edges) + (near * run.tick_s < edges)
    begins = np.clip(near, 0, count).astype(np.int64)
    first, behind = begins[:-1], begins[1:]
    some = behind > first
    found = np.full(len(edges) - 1, np.nan)
    found[some] = age(behind[some] - 1)
    before = arrived[(arrived > 0) & (arrived < count)] - 1
    place = np.searchsorted(begins, before, "right") - 1
    inside = (place >= 0) & (place < len(found))
    np.fmax.at(found, place[inside], age(before[inside]).astype(float))
    return found * run.tick_s


def ages(runs: Sequence[Run], view: View) -> Figure:
    """The oldest and the median link over time, and a row per link coloured by its age; peaks of short intervals."""
    tables = [(run, links_between(run, view)) for run in runs]
    heights = [1.3, *(float(np.clip(_ROW_IN * len(links), 0.5, 4.0)) for _, links in tables)]
    figure, axes = over_time(1 + len(runs), runs, view, sum(heights) + 1.2 + 0.2 * len(runs), heights)
    first, last = axes[0].get_xlim()
    edges = np.linspace(first, last, _bins(tables, last - first) + 1)
    peaks = [np.array([peak_ages(run, link, edges) for link in links]) for run, links in tables]
    finite = np.concatenate([table[np.isfinite(table)] for table in peaks])
    if not len(finite):
        raise NothingToDraw("the log holds no tick of that time")
    low = max(float(finite[finite > 0].min(initial=np.inf)), 1e-3)
    low = low if np.isfinite(low) else 1e-3
    norm = LogNorm(low, max(float(finite.max()), 2.0 * low))
    middle = (edges[1:] + edges[:-1]) / 2
    for r, table in enumerate(peaks):
        known = np.isfinite(table).any(axis=0)
        middling = np.median(table[:, known], axis=0)
        for kind, values, style in (("oldest", table[:, known].max(axis=0), "-"), ("median", middling, ":")):
            axes[0].plot(
                middle[known], values, color=COLOURS[r % len(COLOURS)], linestyle=style, linewidth=THIN, gid=kind
            )
    solid = ["oldest link"] if len(runs) == 1 else [f"{run.label}: oldest, solid" for run in runs]
    legend_of(
        figure,
        [
            *((name, COLOURS[r % len(COLOURS)], "-") for r, name in enumerate(solid)),
            ("median link" if len(runs) == 1 else "median link, dotted", COLOURS[0] if len(runs) == 1 else "0.3", ":"),
        ],
    )
    axes[0].set_ylabel("age [s]")
    if view.log_scale and finite.max() > 0.0:  # without latency, every age is 0
        axes[0].set_yscale("log", nonpositive="mask")
        plain_decades(axes[0].yaxis)
    else:
        axes[0].set_ylim(0.0, None)
    for ax, (run, links), table in zip(axes[1:], tables, peaks, strict=True):
        which = run.label if len(runs) > 1 else ""
        if len(links) > _MOST_LINKS:
            which = f"{which}\n" * bool(which) + f"the {_MOST_NAMED} oldest of {len(links)}"
            order = np.argsort(-np.nan_to_num(np.nanmean(table, axis=1)), kind="stable")[:_MOST_NAMED]
            links, table = [links[k] for k in order], table[order]
        mesh = ax.pcolormesh(edges, np.arange(len(links) + 1) - 0.5, np.ma.masked_invalid(table), norm=norm,
                             cmap="cividis", rasterized=True)  # fmt: skip
        ax.set_ylim(len(links) - 0.5, -0.5)
        name_rows(ax, [f"{a}→{b}" for a, b in links], LABEL_PT)
        ax.set_ylabel(f"link\n{which}" if which else "link")
        ax.grid(False)
    bar = figure.colorbar(mesh, ax=axes[1:], location="right", aspect=18, pad=0.02)
    bar.set_label("age [s]")
    plain_decades(bar.ax.yaxis)
    finish(figure, axes, runs)
    return figure


def _bins(tables: Sequence[tuple[Run, Sequence[Link]]], span: float) -> int:
    """How many intervals: each holds a whole tooth of the usual length, or each tooth many of them."""
    gaps = []
    for run, links in tables:
        for link in links:
            _, due, fate = fates_of(run, link)
            gaps.append(np.diff(np.unique(due[fate == Cause.DELIVERED])))
    together = np.concatenate(gaps) if gaps else np.empty(0)
    tooth = float(np.median(together)) if len(together) else 0.0
    if tooth > 8.0 * span / _BINS:
        return 2 * _BINS
    return max(1, min(_BINS, int(span / (2.0 * tooth)))) if tooth else _BINS
