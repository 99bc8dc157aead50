"""Every picture of a run: which there are, drawn and written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from fleet.addons.pictures import any_signal, exchange, track
from fleet.addons.pictures.axes import (
    MOST_NAMED,
    SMALLEST,
    Get,
    draw_lines,
    finish,
    legend_of,
    marks_legend,
    over_time,
    within,
)
from fleet.addons.pictures.axes import bounds as draw_bounds
from fleet.addons.pictures.beliefs import beliefs
from fleet.addons.pictures.exchange import FATES, fates_of, links_between, name_rows, rank
from fleet.addons.pictures.runs import NothingToDraw, Run, View, load, origin, with_gaps
from fleet.addons.pictures.style import (
    COLUMN_IN,
    HEAVY,
    LABEL_PT,
    STYLES,
    THIN,
    Drawn,
    figures,
    panels,
    plain_decades,
    save_all,
    words_of,
)
from fleet.addons.pictures.thresholds import draw_thresholds, thresholds
from fleet.errors import FleetError
from fleet.logs.open_log import Log
from fleet.logs.payload_kinds import DAMAGED, count_kinds
from fleet.logs.reader import OnProgress, log_path
from fleet.logs.records import Array
from fleet.logs.schemas import CLOCK
from fleet.logs.topic import TooLargeError
from fleet.logs.topic_names import link_topic
from fleet.notebook import Pictures
from fleet.palette import COLOURS
from fleet.result.file import ResultError, read_result
from fleet.result.timing import Spread, Timing
from fleet.scenario.sections.per_vehicle import Control
from fleet.scenario.sections.signals import parse_name
from netem.cause import Cause
from netem.clock import Clock
from netem.condition import Link

# --- time series
# Signals of the vehicles over time: errors with the limits of checks, inputs with their limits.


FORCES = (("surge force", "N"), ("pitch moment", "N m"), ("yaw moment", "N m"))
HEAVY_SUFFIX = "-saturated"
_AT_LIMIT = 1.0 - 1e-6


def component(group: str, name: str, k: int = 0) -> Get:
    def get(run: Run, i: int) -> tuple[Array, Array] | None:
        found = run.series(i, group, name)
        if found is None or found[1].shape[1] <= k:
            return None
        return found[0], found[1][:, k]

    return get


def consensus(runs: Sequence[Run], view: View) -> Figure:
    """|e_i| of each vehicle."""
    return _norm(runs, view, "e_norm", "consensus error $|e|$ [m]", "consensus")


def formation(runs: Sequence[Run], view: View) -> Figure:
    """Distance of each vehicle from its desired position; below it what vehicles that navigate believe of it."""
    believed = any(beliefs(run.log, i) for run in runs for i in run.vehicles(view))
    return _norm(runs, view, "formation_norm", "formation error [m]", "formation", believed=believed)


def _believed_formation(run: Run, i: int) -> tuple[Array, Array] | None:
    known = beliefs(run.log, i)
    if known is None:
        return None
    t, values = with_gaps(known.t, known.formation_norm[:, np.newaxis], known.step_s)
    return t, values[:, 0]


def _norm(runs: Sequence[Run], view: View, name: str, label: str, error: str, *, believed: bool = False) -> Figure:
    figure, axes = over_time(2, runs, view) if believed else over_time(1, runs, view, 2.4)
    log = view.log_scale is not False
    panel = list(zip(axes, (component("error", name), _believed_formation), strict=False))
    notes = draw_lines(figure, panel, runs, view, log=log)
    draw_thresholds(axes[0], thresholds(runs, error))
    for ax, text in zip(axes, (label, "as they believe it [m]"), strict=False):
        ax.set_ylabel(text)
        if log:
            _logarithmic(ax)
        else:
            ax.set_ylim(0.0, None)
    finish(figure, axes, runs, notes)
    return figure


def _logarithmic(ax: Axes) -> None:
    """A logarithmic axis from a micrometre on."""
    values = [np.asarray(line.get_ydata(), float) for line in ax.get_lines()]
    low = min((v[np.isfinite(v) & (v > 0)].min(initial=np.inf) for v in values), default=np.inf)
    if low == np.inf:
        return
    ax.set_yscale("log", nonpositive="mask")
    if low < SMALLEST:
        ax.set_ylim(SMALLEST, None)
    plain_decades(ax.yaxis)


def inputs(runs: Sequence[Run], view: View) -> Figure:
    """Force and moments as applied; heavy where the commanded ones are at their limit."""
    figure, axes = over_time(3, runs, view)
    panel = [(ax, component("command", "applied", k)) for k, ax in enumerate(axes)]
    notes = draw_lines(figure, panel, runs, view, drawstyle="steps-post")  # an input is held until the next
    saturated = False
    for k, ax in enumerate(axes):
        most: dict[str, float] = {}
        for run in runs:
            for i, control in _controls(run, view):
                most[f"{run.slug}-vehicle-{i}"] = control.tau_max[k]
                saturated |= _heavy(ax, run, view, i, k, control.tau_max[k])
        name, unit = FORCES[k]
        ax.set_ylabel(f"{name} [{unit}]")
        if far := draw_bounds(ax, [(-value, value) for value in most.values()], f"limits of the {name}", unit):
            notes.append(far)
        elif most:
            _keep_inside(ax, most)
    if saturated:
        many = any(len(run.vehicles(view)) > MOST_NAMED for run in runs)
        notes.append(f"heavy: {'the command of a named one' if many else 'the command'} is at a limit")
    finish(figure, axes, runs, notes)
    return figure


def _keep_inside(ax: Axes, most: dict[str, float]) -> None:
    """No part of a line's width lies beyond the limit of its gid in `most`; values that do not keep it are shown."""
    artists: list[Line2D | Collection] = [*ax.get_lines(), *ax.collections]
    for artist in artists:
        if artist.get_gid() == "bound":
            continue
        limit = most.get(str(artist.get_gid() or "").removesuffix(HEAVY_SUFFIX), max(most.values()))
        if not _largest(artist) <= limit / _AT_LIMIT:
            continue
        inside = Rectangle((0.0, -limit), 1.0, 2.0 * limit, transform=ax.get_yaxis_transform())
        artist.set_clip_path(inside)


def _largest(artist: Line2D | Collection) -> float:
    if isinstance(artist, Line2D):
        heights = np.asarray(artist.get_ydata(), float)
    else:
        heights = np.concatenate([np.asarray(path.vertices)[:, 1] for path in artist.get_paths()] or [np.empty(0)])
    return float(np.nanmax(np.abs(heights), initial=0.0))


def _heavy(ax: Axes, run: Run, view: View, i: int, k: int, limit: float) -> bool:
    found, commanded = run.series(i, "command", "applied"), run.series(i, "command", "tau")
    line = next((one for one in ax.get_lines() if one.get_gid() == f"{run.slug}-vehicle-{i}"), None)
    if found is None or commanded is None or line is None or not limit > 0.0:
        return False
    t, values = within(found[0], found[1][:, k], view.window)
    _, asked = within(*commanded, view.window)
    at_limit = np.abs(asked[:, k]) >= _AT_LIMIT * limit
    if not at_limit.any():
        return False
    for heavy in (at_limit & (values > 0.0), at_limit & (values < 0.0)):  # no line joins the one limit with the other
        if not heavy.any():
            continue
        ax.plot(
            t, np.where(heavy, values, np.nan), color=line.get_color(), linewidth=2.0 * HEAVY, alpha=0.6,
            solid_capstyle="butt", marker="|", markersize=2.0 * HEAVY, drawstyle="steps-post",
            gid=f"{run.slug}-vehicle-{i}{HEAVY_SUFFIX}",
        )  # fmt: skip
    return True


def _controls(run: Run, view: View) -> list[tuple[int, Control]]:
    if run.scenario is None:
        return []
    return [(i, run.scenario.controls[i - 1]) for i in run.vehicles(view) if i <= run.scenario.vehicles]


# --- timing: how punctual a run on a wall clock was: how late each agent answered, and what a packet's delay became


GREY = "#999999"


def punctuality(runs: Sequence[Run], view: View) -> Figure:
    """Above, what share of each agent's answers took longer than so long; below, of deliveries."""
    (run,) = runs
    timing = _timing(run)
    figure, (top, bottom) = panels(2, 1, COLUMN_IN, 3.9)
    rows = {i: timing.vehicles[str(i)] for i in run.vehicles(view)}
    worst = sorted(rows, key=lambda i: -rows[i].response.p99_ms)[: MOST_NAMED - 1]
    for i, row in rows.items():
        k = sorted(worst).index(i) if i in worst else -1
        colour, style = (COLOURS[k], STYLES[k]) if k >= 0 else (GREY, "-")
        _tail(top, row.response.histogram_ms, row.response.negative, colour, style)
    top.axvline(timing.world.period_ms, color="#000000", linewidth=THIN, linestyle=(0, (1, 1)))
    top.set_ylabel("share of answers slower")
    links = timing.netem.links.values()
    shown: list[tuple[str, str, Any, list[tuple[float, int]]]] = [
        ("injected, sim time", COLOURS[4], "-", _sum(link.injected for link in links)),
        ("measured, sim time", COLOURS[6], "--", _sum(link.measured for link in links)),
        ("network to agent, wall time", COLOURS[5], "-.", timing.netem.hop.histogram_ms),
    ]
    for _, colour, style, histogram in shown:
        _tail(bottom, histogram, 0, colour, style)
    bottom.set_ylabel("share of packets slower")
    for ax in (top, bottom):
        ax.set_xscale("log")
        ax.set_yscale("log")
    top.tick_params(labelbottom=True)
    top.text(timing.world.period_ms, 0.6, " a tick", fontsize=LABEL_PT, va="top")
    top.set_xlabel("answer after its tick began [ms of wall time]")
    bottom.set_xlabel("delay [ms]")
    more = [("others", GREY, "-")] if len(rows) > len(worst) else []
    legend_of(figure, [*((f"UUV {i}", COLOURS[k], STYLES[k]) for k, i in enumerate(sorted(worst))), *more])
    handles = [Line2D([], [], color=colour, linestyle=style, label=name) for name, colour, style, _ in shown]
    bottom.legend(handles=handles, fontsize=LABEL_PT, loc="lower left")
    return figure


def on_wall_clock(run: Run) -> bool:
    """Whether anything could be late in it."""
    return run.log.run.get(CLOCK) == Clock.REAL


def _timing(run: Run) -> Timing:
    if not on_wall_clock(run):
        raise NothingToDraw("the run was in lockstep, where nothing can be late; see fleet run --clock real")
    try:
        timing = read_result(run.log.path.parent).timing
    except FileNotFoundError as error:
        raise NothingToDraw(f"{error.filename} is not there: the run did not end by itself") from None
    except ResultError as error:
        raise NothingToDraw(str(error)) from None
    if timing is None:
        raise NothingToDraw("the result.json beside the log has no timing")
    if missing := [i for i in run.log.vehicles if str(i) not in timing.vehicles]:
        raise NothingToDraw(f"the result.json beside the log has no timing of vehicle {missing[0]}")
    return timing


def _sum(spreads: Iterable[Spread]) -> list[tuple[float, int]]:
    total: Counter[float] = Counter()
    for spread in spreads:
        for edge, count in spread.histogram_ms:
            total[edge] += count
    return [(edge, total[edge]) for edge in sorted(total)]


def _tail(ax: Axes, histogram: list[tuple[float, int]], below: int, colour: str, style: Any) -> None:
    """The share that took longer than each edge of a histogram; `below` lie under its first."""
    if not histogram:
        return
    edges, counts = (np.array(column, float) for column in zip(*histogram, strict=True))
    total = counts.sum() + below
    slower = 1.0 - (below + np.cumsum(counts)) / total
    # The last bin is reached by no sample: the line ends at the smallest share.
    t = np.concatenate(([edges[0] / 1.12], edges))
    share = np.concatenate(([1.0], np.maximum(slower, 0.5 / total)))
    ax.plot(t, share, color=colour, linestyle=style, drawstyle="steps-post")


# --- shares: the fate of the packets of each link over time: a strip per link with the share of every fate


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
class Row:
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


def timeline(runs: Sequence[Run], view: View) -> Figure:
    """A strip per link: the shares of its packets' fates by sending time, exact where a fault begins or ends."""
    (run,) = runs
    links = links_between(run, view)
    first, last = view.window or (0.0, run.log.end or 1.0)
    found = {link: _named(run, link, first, last) for link in links}
    sent = [times for times, _ in found.values() if len(times)]
    if not sent:
        raise NothingToDraw("no packet was sent in that time")
    faults = [edge for fault in run.log.faults for edge in (fault.begin, fault.end)]
    edges = time_bins(first, last, faults, _period(sent))
    rows = fold([Row(run.link_label(link), _count(*found[link], edges)) for link in links])
    height = float(np.clip(_ROW_IN * len(rows), min(0.3 * len(rows), 1.6), 7.0))
    figure, (ax,) = over_time(1, runs, view, height + 1.2)
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
    name_rows(ax, [row.name for row in rows], LABEL_PT)
    for k, row in enumerate(rows):
        share = f"{100.0 * row.arrived:.3g} %" if row.total else "none"
        ax.annotate(share, (1.0, k), xycoords=("axes fraction", "data"), xytext=(2, 0), textcoords="offset points",
                    fontsize=LABEL_PT - 0.5, va="center", color="0.25", gid="arrived")  # fmt: skip
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


def kinds_line(run: Run, links: Sequence[Link]) -> list[str]:
    """Words on how many packets carried which kind of payload, and how many of these arrived; none if all are alike."""
    kinds = count_kinds(run.log[link_topic(link)] for link in links) or []
    if len([one for one in kinds if one.kind != DAMAGED]) < 2:
        return []
    each = [f"{one.kind} {one.packets} ({one.delivered / one.packets:.0%} whole)" for one in kinds[:_MOST_KINDS]]
    more = [f"{len(kinds) - _MOST_KINDS} more kinds"] if len(kinds) > _MOST_KINDS else []
    return wrap("kinds: " + ", ".join(each + more), 54)


def fold(rows: list[Row]) -> list[Row]:
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
    return [*worst, Row(f"{len(others)} others" if worst else f"all {len(others)}", together)]


def time_bins(first: float, last: float, faults: Sequence[float], period: float) -> Array:
    """Edges [s] of bins of about the same width, with an edge exactly where a fault begins or ends."""
    span = last - first
    width = max(span / _BINS, min(_PER_BIN * period, span / 20.0), period)
    corners = sorted({first, last, *(edge for edge in faults if first < edge < last)})
    parts = [np.linspace(a, b, max(1, int((b - a) / width)) + 1)[:-1] for a, b in pairwise(corners)]
    return np.append(np.concatenate(parts), last)


def strips(rows: Sequence[Row], fates: Sequence[str], edges: Array) -> dict[str, list[Array]]:
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


def _named(run: Run, link: Link, first: float, last: float) -> tuple[Array, Array]:
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


Draw = Callable[[Sequence[Run], View], Figure]
_Picture = tuple[str, str, Draw]
# What one can ask for -> the pictures that answer: (name of the file, what it shows, how). By the name of its file one
# can ask for a single picture, too.
WHAT: dict[str, tuple[_Picture, ...]] = {
    "track": (
        ("track", "The vehicles' ways from above, in north and east", track.top),
        ("track-3d", "The same in three dimensions", track.space),
    ),
    "error": (
        ("error", "Consensus error of each vehicle, from true positions", consensus),
        ("formation", "Distance of each vehicle from its place in the formation", formation),
    ),
    "inputs": (("inputs", "Force and moments as applied, limits, and where a limit was met", inputs),),
    "links": (("links", "What became of the packets of each link, as shares over time", timeline),),
    "messages": (("messages", "Messages between the agents in space and time", exchange.spacetime),),
    "ages": (("ages", "Age of what was last heard on each link", exchange.ages),),
    "checks": (),  # a picture for each signal that the checks name
    "timing": (("timing", "On a wall clock: how late agents answered, what delays became", punctuality),),
}
# Those that are left out where everything is asked for, if they hold for none of the runs.
_ONLY_IF: dict[str, Callable[[Run], bool]] = {
    "timing": lambda run: on_wall_clock(run) and not run.of_nodes,
    **dict.fromkeys(("track", "error", "inputs"), lambda run: not (run.of_nodes or run.moored)),
}
PER_RUN = frozenset({"links", "messages", "timing"})  # those that show one run only: of several, each has its own


def check_signals(what: Sequence[str], runs: Sequence[Run]) -> None:
    """Raises FleetError: a signal among what is asked for is in none of the logs."""
    single = {picture[0] for pictures in WHAT.values() for picture in pictures}
    for word in what:
        if word not in WHAT and word not in single and (name := parse_name(word)) is not None:
            any_signal.need(runs, name)


def draw(
    what: Sequence[str], runs: Sequence[Run], view: View, share: OnProgress = lambda _: None
) -> Iterator[tuple[str, str, Figure | str]]:
    """(file name, what it shows, the figure or why there is none) of everything that is asked for. `share`: called
    before each with the share that is done.
    """
    for name, title, _, figure in _each(what, runs, view, share):
        yield name, title, figure


def _each(
    what: Sequence[str], runs: Sequence[Run], view: View, share: OnProgress
) -> Iterator[tuple[str, str, Sequence[Run], Figure | str]]:
    asked_for_all = {*what, *PER_RUN} >= set(WHAT)  # a report of several runs has those of one run elsewhere
    begun: set[str] = set()
    single = {picture[0]: (picture,) for pictures in WHAT.values() for picture in pictures}
    for number, kind in enumerate(what):
        share(number / len(what))
        if asked_for_all and kind in _ONLY_IF and not any(map(_ONLY_IF[kind], runs)):
            continue
        pictures = _pictures(kind, runs, single)
        if not pictures and not asked_for_all:
            yield kind, kind, runs, "no check of the scenario names a signal that has no picture of its own"
        for name, title, make in pictures:
            if name in begun:
                continue
            begun.add(name)
            each = [[run] for run in runs] if kind in PER_RUN else [list(runs)]
            for some in each:
                called = name if len(each) == 1 else f"{name}-{some[0].slug}"
                shown = title if len(each) == 1 else f"{title}: {some[0].label}"
                try:
                    yield called, shown, some, make(some, view)
                except (NothingToDraw, TooLargeError) as reason:
                    yield called, shown, some, str(reason)


def _pictures(kind: str, runs: Sequence[Run], single: Mapping[str, tuple[_Picture, ...]]) -> Sequence[_Picture]:
    if kind in WHAT or kind in single:
        named = any_signal.signals_of_checks(runs) if kind == "checks" else []
        found = WHAT.get(kind, ()) or single.get(kind, ())
    else:
        signal = parse_name(kind)
        named, found = [] if signal is None else [signal], ()
    own = [(any_signal.file_name(one), any_signal.title(runs, one), any_signal.picture(one)) for one in named]
    return [*found, *own]


def write(
    what: Sequence[str],
    runs: Sequence[Run],
    view: View,
    folder: Path,
    formats: Sequence[str],
    tell: Callable[[str], None],
    share: OnProgress = lambda _: None,
) -> list[Path]:
    """Draw into a folder, which is made if need be; returns the files. `tell` gets a sentence about each picture that
    could not be drawn. Raises FleetError if the folder cannot be written.
    """
    return save_all(_with_origins(_each(what, runs, view, share)), folder, formats, tell)


def _with_origins(drawn: Iterable[tuple[str, str, Sequence[Run], Figure | str]]) -> Iterator[Drawn]:
    for name, title, of, figure in drawn:
        yield name, figure, partial(origin, of, title)


def plot(
    log: str | Path | Log,
    what: str | Sequence[str] = (),
    *,
    out: str | Path | None = None,
    format: str | Sequence[str] = "png",
) -> Pictures:
    """Draw pictures of a log, as `fleet plot` does.

    Example:
        >>> figure = fleet.plot("runs/latest", "error")["error"]
        >>> figure.set_size_inches(3.5, 2.5)
        >>> figure.savefig("error.pdf")

    Args:
        log: an MCAP file, a run directory, or a log that is open.
        what: as `--what`: `track`, `error`, `inputs` or another word, or signals such as `state.z`, as a list or with
            commas between them. Empty: all that the log has data for.
        out: the folder into which they are written as well; None: no file is written.
        format: of the files: `png`, `svg`, `pdf`, or several of them.

    Returns:
        The figures by name. A notebook shows them.

    Raises:
        LogReadError: the log cannot be read.
        FleetError: there is no such picture or signal, it has no data, or the folder cannot be written.
    """
    path = log.path if isinstance(log, Log) else log_path(Path(log))
    words = words_of(what)
    single = [name for pictures in WHAT.values() for name, *_ in pictures]
    if strange := [word for word in words if word not in (*WHAT, *single) and parse_name(word) is None]:
        raise FleetError(f"there is no picture {strange[0]!r}; expected some of {', '.join(WHAT)}, or a signal")
    runs = load([path])
    check_signals(words, runs)
    said: list[str] = []
    drawn = _with_origins(_each(words or list(WHAT), runs, View(), lambda _: None))
    found = figures(drawn, None if out is None else Path(out), words_of(format), said.append)
    if words and said:
        raise FleetError("; ".join(said))
    return Pictures(found)
