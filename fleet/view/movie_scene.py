"""One picture of a movie: the fleet and its links, the faults and the time, and formation errors so far."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from math import cos, floor, log10, sin
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from fleet.logs.records import Array
from fleet.palette import COLOURS
from fleet.pictures.style import LABEL_PT, LEGEND_PT, TEXT_PT, THIN
from fleet.recorder.link_state import BEHIND, CUT, GONE, LinkState
from fleet.scenario.sections.vehicle_events import vehicle_events
from fleet.view.movie_camera import SCENE_PT, Camera
from fleet.view.movie_chart import MovieChart, colour_of
from fleet.view.picture import SAMPLE_S, Picture, Row

WIDTH_IN, HEIGHT_IN = 6.0, 4.5
TRAIL_S = 30.0
PACKET_S, MOST_PACKET_S = 0.45, 3.0  # of the movie, that a packet is on its way
APART_S = 0.3  # of the movie, between two packets of a link that are shown
FAULT = "#C1272D"
PASSED = "#00704A"
SILENT = "#808080"
MANY, CROWD = 12, 24  # vehicles, from which on there is less room for each
WORST = 5  # of a crowd, that have their numbers: those that are farthest off their places
OUTLINE = np.array([(0.0, 0.3), (0.1, 0.65), (0.25, 1.0), (0.75, 1.0), (0.92, 0.7), (1.0, 0.0)])  # along, half width


class Look(NamedTuple):
    """How a link in a state is drawn."""

    colour: str
    width: float  # pt
    dash: Any


LOOKS = {
    LinkState.DELIVERING: Look("#0072B2", 0.9, "-"),
    LinkState.LATE: Look("#E69F00", 1.3, (0, (7, 2))),
    LinkState.LOSING: Look("#E69F00", 1.5, (0, (3, 2))),
    LinkState.CUT: Look(FAULT, 2.0, (0, (1, 1.2))),
    LinkState.STALE: Look(SILENT, 1.2, (0, (1, 2.5))),
    LinkState.SILENT: Look("#C8C8C8", 0.6, "-"),
}
DRAWN_COLOURS = (*(colour for colour in COLOURS if colour != "#000000"), FAULT)  # beside greys
PACKET = LOOKS[LinkState.DELIVERING].colour
PACKETS = {CUT: FAULT, GONE: "#E69F00", BEHIND: "#E69F00"}  # others have the colour PACKET


class _Flight(NamedTuple):
    """A packet on its way: from when to when [s of the movie]."""

    link: int
    begin_s: float
    end_s: float
    fate: str


class MovieScene:
    """Draws frames of a picture, one after the other, into one figure."""

    def __init__(
        self,
        picture: Picture,
        begin_s: float,
        end_s: float,
        rate: float,
        *,
        above: bool,
        verdict: Row | None = None,
        charted: Mapping[str, tuple[str, Mapping[int, str]]] | None = None,
    ) -> None:
        """Draw what stays.

        Args:
            picture: of the log; its faults are all known.
            begin_s, end_s: of the movie [simulated time].
            rate: simulated seconds per second of the movie.
            above: whether the fleet is seen from above, or in 3D.
            verdict: on the run: its `text`, and whether it has `passed`; None: there is none.
            charted: signals that are drawn beside the errors, as `MovieChart` takes them.
        """
        self._setup, self._begin_s, self._rate = picture.setup(), begin_s, rate
        self._camera = Camera(above=above)
        self._links: list[tuple[int, int]] = [(src, dst) for src, dst in self._setup["links"]]
        self._both = {(src, dst) for src, dst in self._links} & {(dst, src) for src, dst in self._links}
        count = self._setup["vehicles"]
        self._size = 1.0 if count <= MANY else 0.7 if count <= CROWD else 0.4  # of what is drawn of each vehicle
        self._trails: dict[int, deque[list[float]]] = {}
        self._flying: list[_Flight] = []
        self._rings: dict[tuple[int, float], tuple[float, float]] = {}  # by sender and time: from when to when [s]
        self._shown_s = [-APART_S] * len(self._links)  # when the last packet of a link was shown [s of the movie]
        self._worst: list[int] = []
        self._drawn: list[Artist] = []
        self.figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
        FigureCanvasAgg(self.figure)
        self._scene = self.figure.add_axes((0.0, 0.28, 1.0, SCENE_PT[1] / 72.0 / HEIGHT_IN))
        self._scene.set(xlim=(0.0, SCENE_PT[0]), ylim=(0.0, SCENE_PT[1]))
        self._scene.set_axis_off()
        name = _short(self._setup["scenario"], 50)
        self.figure.text(0.02, 0.95, name, size=TEXT_PT + 2, weight="bold", parse_math=False)
        if verdict is not None:
            colour = PASSED if verdict["passed"] else FAULT
            self.figure.text(0.7, 0.95, verdict["text"], color=colour, weight="bold", ha="right", parse_math=False)
        self._clock = self.figure.text(0.98, 0.95, "", size=TEXT_PT + 2, weight="bold", ha="right")
        self._faults = self.figure.text(0.02, 0.905, "", color=FAULT, weight="bold", parse_math=False)
        self._events = self.figure.text(0.02, 0.87, "", color="0.25", parse_math=False)
        self._happened = picture.happenings  # of the whole log
        self.figure.text(0.98, 0.905, f"{rate:.3g} x real time", size=LEGEND_PT, color="0.4", ha="right")
        handles = [
            Line2D([], [], color=look.colour, linewidth=look.width, linestyle=look.dash, label=state)
            for state, look in LOOKS.items() if state != LinkState.SILENT
        ]  # fmt: skip
        handles += [
            Line2D([], [], color=PACKET, marker="o", markersize=3, linestyle="", label="packet"),
            Line2D(
                [], [], color="0.3", marker="o", markersize=7, linestyle="", fillstyle="none", label="desired place"
            ),
        ]
        if self._setup["obstacles_m"]:
            handles.append(Line2D([], [], color="0.8", marker="o", markersize=7, linestyle="", label="obstacle"))
        self._scene.legend(handles=handles, loc="lower left", ncols=len(handles), borderpad=0.2, handletextpad=0.5,
                           columnspacing=0.7 if self._setup["obstacles_m"] else 1.2)  # fmt: skip
        window = begin_s, end_s
        self._chart = MovieChart(self.figure, window, self._setup["vehicles"], picture.known_faults, charted or {})

    def remember(self, history: Row) -> None:
        """Take the way that the vehicles have come before the first picture."""
        for sample in history["samples"]:
            for i, *place in np.reshape(sample[4], (-1, 4)).tolist():
                self._trails.setdefault(int(i), deque(maxlen=int(TRAIL_S / SAMPLE_S))).append(place)

    def draw(self, frame: Row, at_s: float) -> None:
        """Draw a frame.

        Args:
            frame: as `Picture.frame` gives it.
            at_s: its time in the movie.
        """
        for artist in self._drawn:
            artist.remove()
        self._drawn = []
        self.remember(frame)
        if self._setup["vehicles"] <= CROWD:  # else nobody could follow them
            self._take_packets(frame["packets"], at_s)
        self._worst = sorted(range(1, len(frame["errors"]) + 1), key=lambda i: -(frame["errors"][i - 1] or 0.0))[:WORST]
        self._write(frame)
        self._chart.draw(frame)
        rows = {row[0]: row for row in frame["uuv"]}
        wanted = np.array(frame.get("offsets_m", self._setup["offsets_m"])) + frame["ref"]
        camera = self._camera
        camera.follow(np.array([*(row[1:4] for row in rows.values()), *wanted]))
        deep = max([*wanted[:, 2], *(row[3] for row in rows.values())]) + 0.35 * camera.radius
        self._draw_floor(deep)
        self._draw_obstacles(deep)
        self._draw_compass()
        if not camera.above:
            self._lines_of([camera.project([row[1:4], [*row[1:3], deep]]) for row in rows.values()], 0.0, "0.7", THIN)
        self._draw_trails(rows)
        self._draw_wanted(rows, wanted, frame["ref"])
        self._draw_rings(rows, at_s)
        lanes = self._draw_links(rows, frame["links"])
        self._draw_packets(lanes, at_s)
        self._draw_hulls(rows, frame["states"])

    def _add(self, artist: Artist) -> None:
        self._scene.add_artist(artist)
        self._drawn.append(artist)

    def _lines_of(self, parts: Sequence[Any], order: float, colours: Any, widths: Any, **style: Any) -> None:
        """Add polylines (n, 2 or 3), of which the first two columns count."""
        segments = [np.asarray(part)[:, :2] for part in parts]
        self._add(LineCollection(segments, colors=colours, linewidths=widths, zorder=order, **style))

    def _text(self, x: float, y: float, text: str, **style: Any) -> None:
        self._drawn.append(self._scene.text(x, y, text, clip_on=True, parse_math=False, **style))

    def _write(self, frame: Row) -> None:
        self._clock.set_text(f"t = {frame['t']:.1f} s")
        lasting = [f"{row['what']}, {row['to_s'] - frame['t']:.1f} s left" for row in frame["faults"] if row["active"]]
        more = f"; and {len(lasting) - 2} more" if len(lasting) > 2 else ""
        self._faults.set_text(_short("; ".join(lasting[:2]), 70) + more)
        happened = [str(row) for row in vehicle_events(one for one in self._happened if one[1] <= frame["t"])]
        more = f"; and {len(happened) - 2} more" if len(happened) > 2 else ""
        self._events.set_text(_short("; ".join(happened[:2]), 100) + more)

    def _draw_floor(self, deep: float) -> None:
        camera = self._camera
        step = _step(1.5 * camera.radius)
        reach = np.ceil(2.6 * camera.radius / step) * step
        north, east = (np.round(value / step) * step for value in camera.centre[:2])
        away = np.arange(-reach, reach + step / 2, step)
        parts = [camera.project([(north + k, east - reach, deep), (north + k, east + reach, deep)]) for k in away]
        parts += [camera.project([(north - reach, east + k, deep), (north + reach, east + k, deep)]) for k in away]
        self._lines_of(parts, -1.0, "0.9", 0.5, antialiased=False)  # which makes a GIF a quarter smaller
        self._text(SCENE_PT[0] - 8, 6, f"grid {step:g} m", size=LABEL_PT, color="0.35", ha="right")

    def _draw_obstacles(self, deep: float) -> None:
        """Cylinders that vehicles are to keep out of: their circles on the floor and above, and the sides between."""
        turns = np.linspace(0.0, 2.0 * np.pi, 37)
        top = max(0.0, self._camera.centre[2] - 1.5 * self._camera.radius)
        for north, east, radius in self._setup["obstacles_m"]:
            across = north + radius * np.cos(turns), east + radius * np.sin(turns)
            low, high = (self._camera.project(np.column_stack([*across, np.full_like(turns, z)])) for z in (deep, top))
            sides = [np.vstack([low[k : k + 2], high[[k + 1, k]]])[:, :2] for k in range(36)]
            self._add(PolyCollection(sides, facecolor="0.5", alpha=0.06, zorder=-0.5))
            self._add(PolyCollection([low[:, :2], high[:, :2]], facecolor=to_rgba("0.5", 0.15), edgecolor="0.45",
                                     linewidth=THIN, zorder=-0.5))  # fmt: skip

    def _draw_compass(self) -> None:
        north, east, down = self._camera.centre
        origin, ahead = self._camera.project([(north, east, down), (north + 1.0, east, down)])[:, :2]
        x, y = SCENE_PT[0] - 24.0, 32.0
        along = (ahead - origin) / (np.linalg.norm(ahead - origin) or 1.0)
        tail, tip = np.array([x, y]) - 9 * along, np.array([x, y]) + 9 * along
        self._lines_of([[tail, tip]], 1.0, "0.3", 1.2)
        self._add(PolyCollection([_tip(tail, tip, 5.0)], facecolor="0.3", zorder=1))
        end = tip + 6 * along
        self._text(end[0], end[1], "N", size=LABEL_PT, weight="bold", ha="center", va="center")

    def _draw_trails(self, rows: dict[int, list[Any]]) -> None:
        parts, colours = [], []
        for i, row in rows.items():
            points = self._camera.project([*self._trails.get(i, ()), row[1:4]])
            size = -(-len(points) // 6)
            for k in range(0, len(points) - 1, size):
                parts.append(points[k : k + size + 1])
                colours.append((colour_of(i), 0.12 + 0.5 * k / len(points)))
        self._lines_of(parts, 1.0, colours, 1.2)

    def _draw_wanted(self, rows: dict[int, list[Any]], wanted: Array, reference: list[float]) -> None:
        points = self._camera.project(wanted)[:, :2]
        numbers = range(1, len(points) + 1)
        circles = [Ellipse((float(x), float(y)), 10.0 * self._size, 10.0 * self._size) for x, y in points]
        self._add(PatchCollection(circles, facecolor="none", edgecolor=[colour_of(i) for i in numbers], linewidth=0.9,
                                  linestyle="--", zorder=2))  # fmt: skip
        ways = [np.vstack([points[i - 1], self._camera.project(rows[i][1:4])[0, :2]]) for i in rows]
        self._lines_of(ways, 1.5, [(colour_of(i), 0.5) for i in rows], THIN, linestyle="--")
        x, y = self._camera.project(reference)[0, :2]
        self._lines_of([[(x - 4, y), (x + 4, y)], [(x, y - 4), (x, y + 4)]], 2.0, "0.1", 1.0)

    def _draw_links(self, rows: dict[int, list[Any]], states: list[str]) -> list[Array | None]:
        """Draw them; returns the two ends of each, None: one of its vehicles is nowhere."""
        lanes: list[Array | None] = []
        by_state: dict[LinkState, list[Array]] = {}
        for (src, dst), state in zip(self._links, states, strict=True):
            if src not in rows or dst not in rows:
                lanes.append(None)
                continue
            ends = self._camera.project([rows[src][1:4], rows[dst][1:4]])[:, :2]
            beside = _lane(ends, 13.0 * self._size, 3.0 * self._size if (src, dst) in self._both else 0.0)
            lanes.append(beside)
            by_state.setdefault(LinkState(state), []).append(beside)
        for state, some in by_state.items():
            look = LOOKS[state]
            alpha = 0.6 if state == LinkState.DELIVERING else 0.95
            self._lines_of(some, 3.0, look.colour, look.width * max(0.7, self._size), linestyle=look.dash, alpha=alpha)
            tips = [_tip(ends[0], ends[1], (4.0 + look.width) * self._size) for ends in some]
            self._add(PolyCollection(tips, facecolor=look.colour, alpha=alpha, zorder=3))
            if state == LinkState.CUT:
                self._crosses([ends.mean(axis=0) for ends in some], 3.5 * self._size, look.colour)
        return lanes

    def _crosses(self, at: Sequence[Array], size: float, colour: str) -> None:
        turns = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]]) * size
        self._lines_of([point + turn for point in at for turn in turns], 4.0, colour, 1.8)

    def _take_packets(self, packets: list[list[Any]], now_s: float) -> None:
        """Of each link as many as the eye can follow; what became of one is known when it has arrived or is lost."""
        for link, sent_s, late_s, fate in packets:
            begin_s = (sent_s + max(late_s, 0.0) - self._begin_s) / self._rate
            if begin_s >= self._shown_s[link] + APART_S:
                self._shown_s[link] = begin_s
                lasts_s = min(MOST_PACKET_S, max(PACKET_S, late_s / self._rate))
                self._flying.append(_Flight(link, begin_s, begin_s + lasts_s, fate))
                if self._setup["acoustic"] and fate != CUT:
                    self._rings[self._links[link][0], sent_s] = begin_s, begin_s + lasts_s
        self._flying = [flight for flight in self._flying if flight.end_s > now_s]
        self._rings = {sent: span for sent, span in self._rings.items() if span[1] > now_s}

    def _draw_rings(self, rows: dict[int, list[Any]], now_s: float) -> None:
        """Sound that spreads from who sends: at the end as wide as the farthest place in sight."""
        turns = np.linspace(0.0, 2.0 * np.pi, 37)
        circles, colours = [], []
        for (src, _), (begin_s, end_s) in self._rings.items():
            share = (now_s - begin_s) / (end_s - begin_s)
            if share < 0.0 or src not in rows:
                continue
            north, east, down = rows[src][1:4]
            radius = share * 2.0 * self._camera.radius
            places = [north + radius * np.cos(turns), east + radius * np.sin(turns), np.full_like(turns, down)]
            circles.append(self._camera.project(np.column_stack(places)))
            colours.append(to_rgba(PACKET, 0.7 * (1.0 - share)))
        self._lines_of(circles, 2.0, colours, 1.2)

    def _draw_packets(self, lanes: list[Array | None], now_s: float) -> None:
        by_colour: dict[str, list[Array]] = {}
        for link, begin_s, end_s, fate in self._flying:
            share = (now_s - begin_s) / (end_s - begin_s)
            ends = lanes[link]
            stop = 0.3 if fate == CUT else 0.55 if fate == GONE else 1.0
            if ends is None or share < 0.0:
                continue
            colour = PACKETS.get(fate, PACKET)
            point = ends[0] + min(share, stop) * (ends[1] - ends[0])
            if share > stop:
                self._crosses([point], 2.0 * self._size, colour)
            else:
                by_colour.setdefault(colour, []).append(point)
        for colour, points in by_colour.items():
            dots = [Ellipse((float(x), float(y)), 4.0 * self._size, 4.0 * self._size) for x, y in points]
            self._add(PatchCollection(dots, facecolor=colour, edgecolor="white", linewidth=0.4, zorder=5))

    def _draw_hulls(self, rows: dict[int, list[Any]], states: dict[int, str]) -> None:
        camera, least = self._camera, 26.0 * self._size
        order = {i: -float(camera.project(row[1:4])[0, 2]) for i, row in rows.items()}
        hulls, colours = [], []
        for i in sorted(rows, key=order.__getitem__):
            row, state = rows[i], states.get(i, "")
            length, width = self._setup["hulls_m"][i - 1]
            drawn = max(length, least / camera.scale)
            tail, nose = _axis(row, drawn)
            thick = max(width * drawn / length * camera.scale, 0.22 * least)
            ends = camera.project([tail, nose])[:, :2]
            hulls.append(_hull(ends[0], ends[1], thick / 2))
            colours.append(SILENT if "no agent" in state or "diverged" in state else colour_of(i))
            self._label(i, row, state, camera.project(row[1:4])[0])
        self._add(PolyCollection(hulls, facecolor=colours, edgecolor="white", linewidth=0.6, zorder=6))

    def _label(self, i: int, row: list[Any], state: str, at: Array) -> None:
        x, y, count = float(at[0]) + 8, float(at[1]) + 10, self._setup["vehicles"]
        if count > CROWD and i not in self._worst:
            return
        text = f"{i}  {state}" if state else f"{i}"
        box = {
            "boxstyle": "round,pad=0.2",
            "facecolor": FAULT if state else "white",
            "edgecolor": "none",
            "alpha": 0.85,
        }
        self._text(
            x, y, text, size=TEXT_PT, weight="bold", color="white" if state else colour_of(i), bbox=box, zorder=7
        )
        if count <= MANY:
            self._text(x, y - 9, f"{row[3]:.1f} m deep", size=LABEL_PT, color="0.35", zorder=7)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 4]} ..."


def _step(value: float) -> float:
    """The next lower of 1, 2, 5, 10, ..."""
    power = 10.0 ** floor(log10(value))
    return power * max(digit for digit in (1.0, 2.0, 5.0) if digit * power <= value)


def _axis(row: list[Any], length: float) -> tuple[Array, Array]:
    """Tail and nose of a vehicle of a frame [m]."""
    north, east, down, pitch, heading = row[1:6]
    half = length / 2 * np.array([cos(pitch) * cos(heading), cos(pitch) * sin(heading), -sin(pitch)])
    place = np.array([north, east, down])
    return place - half, place + half


def _hull(tail: Array, nose: Array, half: float) -> Array:
    """The outline of a torpedo between two points."""
    along = nose - tail
    aside = np.array([-along[1], along[0]]) / (np.linalg.norm(along) or 1.0) * half
    sides = [tail + share * along + sign * wide * aside for sign in (1, -1) for share, wide in OUTLINE[::sign]]
    return np.array(sides)


def _lane(ends: Array, short: float, aside: float) -> Array:
    """The ends of a link, short of the hulls, and beside the lane of the other direction."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along)) or 1.0
    along = along / length
    keep = min(short, 0.4 * length)
    return np.array([ends[0] + keep * along, ends[1] - keep * along]) + aside * np.array([along[1], -along[0]])


def _tip(begin: Array, end: Array, size: float) -> Array:
    """The head of an arrow."""
    along = (end - begin) / (np.linalg.norm(end - begin) or 1.0)
    aside = np.array([-along[1], along[0]])
    return np.array([end, end - size * (along + 0.4 * aside), end - size * (along - 0.4 * aside)])
