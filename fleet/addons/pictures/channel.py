"""The timeline of an acoustic channel: a row per modem with what it transmits, hears, and loses.

The log has a packet's end at each receiver. The beginning of its transmission follows from that, from the modem's
airtime, and from the distance. So logs of older versions have this picture, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fleet.addons.pictures.axes import finish, marks_legend, time_axes
from fleet.addons.pictures.exchange import FATES, links_between, name_rows, rank
from fleet.addons.pictures.look import label_pt
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View
from fleet.logs.open_log import open_log
from fleet.logs.topic_names import link_topic
from fleet.logs.transmissions import AT_START, UNSENT, begin_of, end_of, name_of
from fleet.mcap.records import Array
from netem.cause import Cause
from netem.condition import Link
from netem.modem import AcousticConfig
from netem.modem_frame import size_on_air

SENDS, OVERHEARD = "transmits", "overhears"
_COLOURS = {SENDS: "#1F3A5F", OVERHEARD: "#DDDDDD"}
_ROUNDS = 16  # transmissions that the picture shows unless a window is given
_LANES = 3  # for receptions of one modem that overlap
_MOST_MODEMS = 24
_NAMED = 0.02  # of the time axis: a reception that is longer has its sender's number


class DrawnTransmission(NamedTuple):
    """A packet on the air."""

    src: int
    begin: float  # s
    airtime: float  # s
    # (modem, when it begins there [s], fate). A modem that it is not for, or that is cut off, overhears it.
    heard: tuple[tuple[int, float, str], ...]


def is_acoustic(run: LoggedRun) -> bool:
    """Whether a run has an acoustic channel."""
    return run.scenario is not None and run.scenario.acoustic is not None


def transmissions(run: LoggedRun, links: Iterable[Link]) -> list[DrawnTransmission]:
    """What was on the air for these links, in the order of the beginnings.

    Of a modem with `tries` the last try is known. Its answers, and ranges that the channel measures, are in no log.

    Raises:
        NothingToDraw: the run has no acoustic channel, or its log has no sizes of packets.
    """
    acoustic = None if run.scenario is None else run.scenario.acoustic
    if acoustic is None:
        raise NothingToDraw("the network is not acoustic")
    flights, modems = _Flights(run, acoustic), _modems(run)
    parts: dict[tuple[int, ...], list[tuple[int, float, str, int]]] = {}
    for src, dst in links:
        for seq, sent, due, delay, fate, size in _rows(run, (src, dst)):
            row = dst, end_of(sent, due, delay, fate), fate, size
            parts.setdefault(name_of((src, dst), seq, acoustic), []).append(row)
    found = []
    for (src, *_), rows in parts.items():
        sent_rows = [row for row in rows if row[2] not in UNSENT]
        if sent_rows:
            airtime = acoustic.modem_of(src).airtime_ns(sent_rows[0][3]) / 1e9
            # The row that is nearest to the truth.
            dst, end, fate, _ = min(sent_rows, key=lambda row: (row[2] not in AT_START, row[2] != Cause.DELIVERED))
            way = partial(flights.of, src, dst)
            begin = begin_of((src, dst), airtime, end, fate, way, acoustic, run.tick_s)
            fates = {dst: fate for dst, _, fate, _ in sent_rows if fate not in AT_START}
            away = {dst: flights.of(src, dst, begin) for dst in modems if dst != src}
            reach = acoustic.modem_of(src).interference_range / acoustic.sound_speed
            heard = [(dst, begin + away[dst], fate) for dst, fate in fates.items()]
            heard += [(dst, begin + s, OVERHEARD) for dst, s in away.items() if dst not in fates and s <= reach]
            found.append(DrawnTransmission(src, begin, airtime, tuple(heard)))
    return sorted(found, key=lambda one: (one.begin, one.src))


def _rows(run: LoggedRun, link: Link) -> Iterable[tuple[int, float, float, float, str, int]]:
    """(number, sent [s], due [s], delay [s], fate, bytes) of each packet of a link, without copies."""
    packets = run.log[link_topic(link)]
    if not len(packets):
        return ()
    if "size" in packets:
        sizes = packets["size"]
    elif "payload" in packets:
        sizes = np.array([size_on_air(payload) for payload in packets["payload"]])
    else:
        raise NothingToDraw("the log is too large to know the sizes of its packets: cut it with `fleet export --from`")
    first = packets["copy"] == 0
    columns = [packets[name] for name in ("seq", "sent", "due", "delay", "fate")]
    return zip(*(column[first].tolist() for column in (*columns, sizes)), strict=True)


def _modems(run: LoggedRun) -> list[int]:
    return sorted({*run.log.vehicles, *(i for link in run.log.links for i in link)})


class _Flights:
    """How long sound takes between vehicles."""

    def __init__(self, run: LoggedRun, acoustic: AcousticConfig) -> None:
        self._speed = acoustic.sound_speed
        self._ways: dict[int, tuple[Array, Array]] = {}
        # Of nodes the log has poses alone, which other pictures do not need.
        poses = open_log(run.log.path, "uuv/*/pose") if run.of_nodes else None
        for i in _modems(run):
            if poses is not None and (topic := f"uuv/{i}/pose") in poses and len(poses[topic]):
                self._ways[i] = poses[topic].t, poses[topic]["pose.position"]
                continue
            each = [run.series(i, "state", name) for name in ("x", "y", "z")]
            found = [one for one in each if one is not None]
            if len(found) == len(each):
                self._ways[i] = found[0][0], np.hstack([values for _, values in found])

    def of(self, src: int, dst: int, at: float) -> float:
        """The time [s] for the distance at a moment [s]; 0 if it is not known."""
        if src not in self._ways or dst not in self._ways:
            return 0.0
        a, b = ([float(np.interp(at, t, way[:, k])) for k in range(3)] for t, way in (self._ways[src], self._ways[dst]))
        return float(np.linalg.norm(np.subtract(a, b))) / self._speed


def lanes(spans: Sequence[tuple[float, float]]) -> list[int]:
    """A lane for each span of time, ordered by their beginnings, so that spans in one lane do not overlap."""
    ends: list[float] = []
    found = []
    for begin, end in spans:
        lane = next((k for k, last in enumerate(ends) if last <= begin), len(ends))
        ends[lane : lane + 1] = [end]
        found.append(lane)
    return found


def timeline(runs: Sequence[LoggedRun], view: View) -> Figure:
    """A row per modem: above what it transmits, below what reaches it, each coloured by its fate."""
    (run,) = runs
    on_air = transmissions(run, links_between(run, view))
    if not on_air:
        raise NothingToDraw("no modem has transmitted")
    view = view if view.window else View(view.vehicles, view.log_scale, _moment(on_air, run.log.end))
    assert view.window is not None
    first, last = view.window
    shown = [one for one in on_air if one.begin <= last and _last(one) >= first]
    if not shown:
        raise NothingToDraw(f"no modem has transmitted from {first:g} to {last:g} s")
    every = sorted(view.vehicles or _modems(run))
    modems = every[:_MOST_MODEMS]
    figure, (ax,) = time_axes(1, runs, view, float(np.clip(0.3 * len(modems), 1.0, 6.5)) + 1.2)
    bars = [bar for row, i in enumerate(modems) for bar in _row(row, i, shown)]
    handles = []
    for kind in sorted({bar.kind for bar in bars}, key=lambda kind: (kind != SENDS, kind == OVERHEARD, rank(kind))):
        colour = _COLOURS[kind] if kind in _COLOURS else FATES.get(kind, ("", "#777777"))[1]
        some = [bar.corners() for bar in bars if bar.kind == kind]
        ax.add_collection(
            PolyCollection(some, facecolors=colour, edgecolors="white", linewidths=0.3, gid=f"channel-{kind}", zorder=2)
        )
        handles.append(Patch(color=colour, linewidth=0, label="hears" if kind == Cause.DELIVERED else kind))
    named = _name_senders(ax, bars, view.window)
    ax.set_ylim(len(modems) - 0.5, -0.5)
    name_rows(ax, [run.vehicle_label(i) for i in modems], label_pt())
    for row in range(1, len(modems)):
        ax.axhline(row - 0.5, color="0.85", linewidth=0.4, zorder=1)
    ax.grid(axis="y", visible=False)
    ax.set_ylabel("node" if run.of_nodes else "vehicle")
    marks_legend(figure, handles)
    notes = ["numbers: the senders"] if named else []
    notes += [] if len(modems) == len(every) else [f"{len(modems)} of {len(every)} modems; others with --vehicles"]
    finish(figure, [ax], runs, notes)
    return figure


class _Bar(NamedTuple):
    kind: str
    src: int
    begin: float  # s
    end: float
    top: float  # of rows
    bottom: float

    def corners(self) -> list[tuple[float, float]]:
        top, bottom = self.top, self.bottom
        return [(self.begin, top), (self.end, top), (self.end, bottom), (self.begin, bottom)]


def _row(row: int, i: int, shown: Sequence[DrawnTransmission]) -> Iterator[_Bar]:
    """The bars of one modem: transmissions above the middle of its row, receptions below."""
    for one in shown:
        if one.src == i:
            yield _Bar(SENDS, i, one.begin, one.begin + one.airtime, row - 0.42, row - 0.04)
    heard = sorted((at, at + one.airtime, fate, one.src) for one in shown for dst, at, fate in one.heard if dst == i)
    placed = lanes([(begin, end) for begin, end, _, _ in heard])
    count = min(_LANES, max(placed, default=0) + 1)
    tall = 0.42 / count
    for (begin, end, fate, src), lane in zip(heard, placed, strict=True):
        top = row + 0.02 + tall * min(lane, count - 1)
        yield _Bar(fate, src, begin, end, top, top + 0.9 * tall)


def _name_senders(ax: Axes, bars: Sequence[_Bar], window: tuple[float, float]) -> bool:
    """The sender's number in each reception that has room for it. Returns whether there is one."""
    named = False
    for bar in bars:
        middle, tall = (bar.begin + bar.end) / 2, bar.bottom - bar.top
        wide = bar.end - bar.begin > _NAMED * (window[1] - window[0])
        if bar.kind != SENDS and wide and tall > 0.15 and window[0] < middle < window[1]:
            named = True
            ax.text(middle, (bar.top + bar.bottom) / 2, str(bar.src), color="black", fontsize=label_pt() - 1,
                    ha="center", va="center_baseline", zorder=3)  # fmt: skip
    return named


def _last(one: DrawnTransmission) -> float:
    return max([one.begin, *(at for _, at, _ in one.heard)]) + one.airtime


def _moment(on_air: Sequence[DrawnTransmission], end: float) -> tuple[float, float]:
    """A window of some transmissions: around the first collision, or from the first transmission on. Of a run in which
    few talk it leaves out what is empty before the first and after the last."""
    begins = np.array([one.begin for one in on_air])
    gap = float(np.median(np.diff(begins))) if len(begins) > 1 else 0.0
    width = max(_ROUNDS * gap, 6.0 * max(_last(one) - one.begin for one in on_air[:100]))
    spoiled = [at for one in on_air for _, at, fate in one.heard if fate in (Cause.COLLISION, Cause.HALF_DUPLEX)]
    margin = 0.05 * min(width, end)
    first, last = max(0.0, float(begins[0]) - margin), min(end, max(map(_last, on_air)) + margin)
    begin = max(first, min((min(spoiled) if spoiled else first) - width / 3, last - width))
    return begin, min(begin + width, last)
