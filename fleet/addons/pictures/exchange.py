"""The traffic on the links: messages in space and time, ages of information."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fleet.addons.pictures.axes import finish, legend_of, marks_legend, time_axes
from fleet.addons.pictures.look import label_pt
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View
from fleet.addons.pictures.style import THIN, plain_decades, plain_numbers
from fleet.addons.pictures.thresholds import age_limits, draw_thresholds
from fleet.logs.topic_names import link_topic
from fleet.mcap.records import Array
from fleet.palette import COLOURS
from fleet.scenario.sections.fault_entry import entry_kind, entry_vehicles
from netem.cause import Cause
from netem.condition import Link

CORRUPTED = "corrupted"
# Fate -> (mark, colour). Every one has a mark and a colour of its own: blue for what arrives, grey for what is neither,
# warm for what is lost; what tends to happen together differs in lightness, too.
FATES: dict[str, tuple[str, str]] = {
    Cause.DELIVERED: ("|", "#56B4E9"),
    Cause.IN_FLIGHT: (".", "#777777"),
    Cause.REPLACED: ("P", "#BBBBBB"),  # what an acoustic modem never sends, which is no loss of the channel
    CORRUPTED: ("2", "#CC79A7"),
    Cause.LOSS: ("x", "#D55E00"),
    Cause.PARTITION: ("s", "#7F1D1D"),
    Cause.DOWN: ("v", "#E6A100"),
    Cause.MUTE: ("^", "#F28E2B"),
    Cause.QUEUE: ("D", "#FDC086"),
    Cause.MTU: ("<", "#8C6D1F"),
    Cause.RANGE: (">", "#F6C700"),
    Cause.HALF_DUPLEX: ("h", "#FFA07A"),
    Cause.COLLISION: ("*", "#C51B3A"),
    Cause.SNR: ("X", "#5B1A0B"),
    Cause.DEAD_SENDER: ("8", "#A65628"),
    Cause.DEAF: ("d", "#E7298A"),
    Cause.DEAD_RECEIVER: ("H", "#4A2C0A"),
    Cause.RECEIVER: ("p", "#FF5A36"),
}
_BINS = 300  # of the time axis of the ages, at most; twice as many where every tooth can be seen
_ROUNDS = 12  # shown by the space-time diagram unless a window is given
_MOST_NAMED = 36  # rows
_MOST_VEHICLES = 20  # of the space-time diagram
_MOST_LINKS = 100  # with a row among the ages; of more, the oldest have one
_NUMBER_IN = 0.15  # height that a number beside a bar of colours needs
_ROUNDING = 1e-6  # ticks
_ROW_IN = 0.11  # height of a link's row among the ages, enough for its name


def links_between(run: LoggedRun, view: View) -> list[Link]:
    """The directed links between the vehicles to show. Raises NothingToDraw if there are none, or the log is not one of
    ours.
    """
    run.tick_s  # noqa: B018  (a foreign log has no packets of ours)
    found = [(a, b) for a, b in run.log.links if view.vehicles is None or (a in view.vehicles and b in view.vehicles)]
    if not found:
        raise NothingToDraw("no links between these vehicles" if run.log.links else "the log has no links")
    return found


def fates_of(run: LoggedRun, link: Link) -> tuple[Array, Array, Array, Array]:
    """(sent [s], due [s], fate, sequence) of every packet of a link; a corrupted one's fate is `corrupted`."""
    packets = run.log[link_topic(link)]
    if not len(packets):
        return np.empty(0), np.empty(0), np.empty(0, object), np.empty(0, np.int64)
    fate = np.where(packets["corrupted"] & (packets["fate"] == Cause.DELIVERED), CORRUPTED, packets["fate"])
    return packets["sent"], packets["due"], fate.astype(object), packets["seq"]


def rank(fate: str) -> tuple[int, str]:
    """The place of a fate in legends, and which lies upon which: as in `FATES`."""
    return (list(FATES).index(fate) if fate in FATES else len(FATES)), fate


def name_rows(ax: Axes, names: Sequence[str], size: float) -> None:
    """Names of rows along the vertical axis, as many as can be read."""
    every = -(-len(names) // _MOST_NAMED)
    ax.set_yticks(range(0, len(names), every), names[::every])
    ax.tick_params(axis="y", length=0, labelsize=size)


def spacetime(runs: Sequence[LoggedRun], view: View) -> Figure:
    """Vehicles over time, a line from each sending to the arrival; a lost message ends on its way with its mark."""
    (run,) = runs
    links = links_between(run, view)
    packets = {link: fates_of(run, link) for link in links}
    view = view if view.window else View(view.vehicles, view.log_scale, _moment(run, packets))
    assert view.window is not None
    first, last = view.window
    shown_ones, every = _vehicles_at_worst_link(packets, view.window), len({i for link in links for i in link})
    packets = {link: found for link, found in packets.items() if shown_ones.issuperset(link)}
    vehicles = sorted(shown_ones)
    figure, (ax,) = time_axes(1, runs, view, float(np.clip(0.42 * len(vehicles), 1.2, 6.0)) + 1.2)
    place = {i: k for k, i in enumerate(vehicles)}
    for i in vehicles:
        _life(ax, run, i, place[i])
    lines: dict[str, list[Any]] = {}
    ends: dict[str, list[tuple[float, float]]] = {}
    for (a, b), (sent, due, fate, _) in packets.items():
        shown = (sent <= last) & (np.maximum(sent, due) >= first)
        for s, d, name in zip(sent[shown], due[shown], fate[shown], strict=True):
            # A lost one turns off before it arrives; one whose due time is its sending time has a slope all the same.
            lost = name not in (Cause.DELIVERED, CORRUPTED, Cause.IN_FLIGHT)
            share = 0.45 if lost else 1.0
            until = max(d, s + 0.01 * (last - first)) if lost else d
            end = s + share * (until - s), place[a] + share * (place[b] - place[a])
            lines.setdefault(name, []).append([(s, place[a]), end])
            ends.setdefault(name, []).append(end)
    if not lines:
        raise NothingToDraw(f"no message was under way from {first:g} to {last:g} s")
    handles = []
    for name in sorted(lines, key=rank):
        mark, colour = FATES.get(name, ("p", "#777777"))
        if name == Cause.DELIVERED:
            colour, mark = COLOURS[0], "."
        ax.add_collection(
            LineCollection(lines[name], colors=colour, linewidths=THIN, gid=f"fate-{name}",
                           linestyles="-" if name in (Cause.DELIVERED, CORRUPTED) else (0, (3, 1.5)), zorder=2)
        )  # fmt: skip
        x, y = zip(*ends[name], strict=True)
        ax.plot(
            x, y, linestyle="", marker=mark, color=colour, markersize=2.5 if name == Cause.DELIVERED else 3.5, zorder=3
        )
        handles.append(Line2D([], [], marker=mark, color=colour, linewidth=THIN, markersize=4, label=name))
    ax.set_ylim(len(vehicles) - 0.5, -0.5)
    ax.set_yticks(range(len(vehicles)), [run.vehicle_label(i) for i in vehicles])
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="y", visible=False)
    ax.set_ylabel("node" if run.of_nodes else "vehicle")
    marks_legend(figure, handles)
    some = [] if len(vehicles) == every else [f"{len(vehicles)} of {every} vehicles; others with --vehicles"]
    finish(figure, [ax], runs, some)
    return figure


def _vehicles_at_worst_link(
    packets: dict[Link, tuple[Array, Array, Array, Array]], window: tuple[float, float]
) -> set[int]:
    """The vehicles of these links; of too many those nearest to the link that lost most of its packets in a window."""
    hears: dict[int, set[int]] = {}
    lost: dict[Link, int] = {}
    for (a, b), (sent, _, fate, _) in packets.items():
        hears.setdefault(a, set()).add(b)
        hears.setdefault(b, set()).add(a)
        inside = (sent >= window[0]) & (sent <= window[1])
        lost[a, b] = int((inside & (fate != Cause.DELIVERED) & (fate != Cause.IN_FLIGHT)).sum())
    if len(hears) <= _MOST_VEHICLES:
        return set(hears)
    worst = max(lost, key=lambda link: lost[link])
    found = dict.fromkeys(worst)
    front = list(worst)
    for i in front:  # it grows meanwhile
        new = [j for j in sorted(hears[i]) if j not in found]
        found.update(dict.fromkeys(new))
        front += new
        if len(found) >= _MOST_VEHICLES:
            break
    return set(list(found)[:_MOST_VEHICLES])


def _moment(run: LoggedRun, packets: dict[Link, tuple[Array, Array, Array, Array]]) -> tuple[float, float]:
    """A window of some rounds: before the first failure of a check, or around the first fault, or the first loss."""
    sent = np.unique(np.concatenate([sent for sent, _, _, _ in packets.values()]))
    due = np.concatenate([due - sent for sent, due, _, _ in packets.values()])
    if not len(sent):
        raise NothingToDraw("no packet was sent")
    period = float(np.median(np.diff(sent))) if len(sent) > 1 else 1.0
    width = max(_ROUNDS * period, 4.0 * float(np.percentile(due, 95)), 10 * run.tick_s)
    lost = [s[f != Cause.DELIVERED] for s, _, f, _ in packets.values()]
    first_lost = min((float(times.min()) for times in lost if len(times)), default=run.log.end / 2)
    if run.failures:
        begin = min(at_s for _, at_s in run.failures) - 3 * width / 4
    else:
        begin = (run.log.faults[0].begin if run.log.faults else first_lost) - width / 3
    begin = max(0.0, min(begin, run.log.end - width))
    return begin, min(begin + width, run.log.end)


def _life(ax: Axes, run: LoggedRun, i: int, row: int) -> None:
    absent = [
        (fault.begin, fault.end)
        for fault in run.log.faults
        if entry_kind(fault.entry) in ("kill", "pause") and i in entry_vehicles(fault.entry)
    ]
    at = 0.0
    for begin, end in sorted(absent):
        ax.plot([at, begin], [row, row], color="0.55", linewidth=THIN, zorder=1)
        ax.plot([begin, end], [row, row], color="0.55", linewidth=THIN, linestyle=":", zorder=1, gid=f"absent-{i}")
        at = end
    ax.plot([at, run.log.end], [row, row], color="0.55", linewidth=THIN, zorder=1)


def peak_ages(run: LoggedRun, link: Link, edges: Array) -> Array:
    """The largest age [s] of information on a link in each interval between two edges [s]: see `netem.ages`.

    Only ticks that were started count; NaN where there is none, and in a run that went on from another until something
    arrived, since the log does not have what was heard before. The age grows until something newer arrives, so that
    the largest of an interval is at its last tick, or at the tick before an arrival.
    """
    arrived, heard = _arrivals(run, link)
    begins, count = _first_ticks(run, edges)
    unheard = np.nan if run.log.begin else 0

    def age(at: Array) -> Array:
        known = np.searchsorted(arrived, at, "right")
        return at - np.where(known > 0, np.append(heard, 0)[known - 1], unheard)

    first, behind = begins[:-1], begins[1:]
    some = behind > first
    found = np.full(len(edges) - 1, np.nan)
    found[some] = age(behind[some] - 1)
    before = arrived[(arrived > 0) & (arrived < count)] - 1
    place = np.searchsorted(begins, before, "right") - 1
    inside = (place >= 0) & (place < len(found))
    np.fmax.at(found, place[inside], age(before[inside]).astype(float))
    return found * run.tick_s


def mean_ages(run: LoggedRun, link: Link, edges: Array) -> Array:
    """The mean of the same over the ticks of each interval [s]."""
    arrived, heard = _arrivals(run, link)
    begins, _ = _first_ticks(run, edges)
    at, known = np.append(0, arrived), np.append(0, heard)
    until_arrival = np.append(0, np.cumsum(known[:-1] * np.diff(at)))  # the sum of what was known at each tick before

    def until(tick: Array) -> Array:
        place = np.maximum(np.searchsorted(at, tick, "left") - 1, 0)
        total: Array = until_arrival[place] + known[place] * (tick - at[place])
        return total

    first, behind = begins[:-1], begins[1:]
    ages = (behind * (behind - 1) - first * (first - 1)) / 2 - (until(behind) - until(first))
    some = behind > first
    if run.log.begin:
        some &= first >= (arrived[0] if len(arrived) else np.inf)
    found: Array = np.where(some, ages / np.maximum(behind - first, 1), np.nan) * run.tick_s
    return found


def _arrivals(run: LoggedRun, link: Link) -> tuple[Array, Array]:
    """The ticks at which something arrived on a link, in order, and the newest tick that was heard of then."""
    sent, due, fate, _ = fates_of(run, link)
    good = fate == Cause.DELIVERED
    arrived = np.rint(due[good] / run.tick_s).astype(np.int64)
    order = np.argsort(arrived, kind="stable")
    heard: Array = np.maximum.accumulate(np.rint(sent[good] / run.tick_s).astype(np.int64)[order])
    return arrived[order], heard


def _first_ticks(run: LoggedRun, edges: Array) -> tuple[Array, int]:
    """The first tick from each edge [s] on, and the number of ticks that were started."""
    ticks = int(run.log.run.get("ticks", 0))
    count = min(round(run.log.end / run.tick_s) + 1, ticks) if ticks else round(run.log.end / run.tick_s) + 1
    # An edge that misses a tick by a rounding is at it: otherwise an interval of one tick would now and then be empty.
    first: Array = np.clip(np.ceil(edges / run.tick_s - _ROUNDING), 0, count).astype(np.int64)
    return first, count


def ages(runs: Sequence[LoggedRun], view: View) -> Figure:
    """The oldest and the median link over time, and a row per link coloured by its age. Of each short interval the
    picture has the largest age, and of the median link the mean."""
    tables = [(run, links_between(run, view)) for run in runs]
    heights = [1.3, *(float(np.clip(_ROW_IN * len(links), 0.5, 4.0)) for _, links in tables)]
    figure, axes = time_axes(1 + len(runs), runs, view, sum(heights) + 1.2 + 0.2 * len(runs), heights)
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
    for r, ((run, links), table) in enumerate(zip(tables, peaks, strict=True)):
        means = np.array([mean_ages(run, link, edges) for link in links])
        known = np.isfinite(means).any(axis=0)
        middling = np.nanmedian(means[:, known], axis=0)
        for kind, values, style in (("oldest", np.nanmax(table[:, known], axis=0), "-"), ("median", middling, ":")):
            axes[0].plot(
                middle[known], values, color=COLOURS[r % len(COLOURS)], linestyle=style, linewidth=THIN, gid=kind
            )
    solid = ["oldest link, peaks"] if len(runs) == 1 else [f"{run.label}: oldest, peaks" for run in runs]
    legend_of(
        figure,
        [
            *((name, COLOURS[r % len(COLOURS)], "-") for r, name in enumerate(solid)),
            ("median link, means", COLOURS[0] if len(runs) == 1 else "0.3", ":"),
        ],
    )
    axes[0].set_ylabel("age [s]")
    if view.log_scale and finite.max() > 0.0:  # without latency, every age is 0
        axes[0].set_yscale("log", nonpositive="mask")
        plain_decades(axes[0].yaxis)
    else:
        axes[0].set_ylim(0.0, None)
    notes = draw_thresholds(axes[0], age_limits(runs))
    for ax, (run, links), table in zip(axes[1:], tables, peaks, strict=True):
        which = ""
        if len(runs) > 1:
            ax.set_title(run.label, loc="left", fontsize=label_pt(), parse_math=False)
        if len(links) > _MOST_LINKS:
            which = f"the {_MOST_NAMED} oldest of {len(links)}"
            order = np.argsort(-np.nan_to_num(np.nanmean(table, axis=1)), kind="stable")[:_MOST_NAMED]
            links, table = [links[k] for k in order], table[order]
        mesh = ax.pcolormesh(edges, np.arange(len(links) + 1) - 0.5, np.ma.masked_invalid(table), norm=norm,
                             cmap="cividis", rasterized=True)  # fmt: skip
        ax.set_ylim(len(links) - 0.5, -0.5)
        name_rows(ax, [run.link_label(link) for link in links], label_pt())
        ax.set_ylabel(f"link\n{which}" if which else "link")
        ax.grid(False)
    bar = figure.colorbar(mesh, ax=axes[1:], location="right", aspect=18, pad=0.02)
    bar.set_label("age [s], peaks")
    plain_numbers(bar.ax.yaxis, round(sum(heights[1:]) / _NUMBER_IN))
    finish(figure, axes, runs, [f"peak and mean in bins of {edges[1] - edges[0]:.2g} s", *notes])
    return figure


def _bins(tables: Sequence[tuple[LoggedRun, Sequence[Link]]], span: float) -> int:
    """How many intervals: each holds a tick, and a whole tooth of the usual length, or each tooth many of them."""
    most = max(1, int(span / max(run.tick_s for run, _ in tables) + 1e-6))
    gaps = []
    for run, links in tables:
        for link in links:
            _, due, fate, _ = fates_of(run, link)
            gaps.append(np.diff(np.unique(due[fate == Cause.DELIVERED])))
    together = np.concatenate(gaps) if gaps else np.empty(0)
    tooth = float(np.median(together)) if len(together) else 0.0
    if tooth > 8.0 * span / _BINS:
        return min(2 * _BINS, most)
    return max(1, min(_BINS, most, int(span / (2.0 * tooth)))) if tooth else min(_BINS, most)
