"""One picture of a movie: the fleet and its links, the faults and the time, and formation errors so far."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from math import cos, floor, log10, pi, sin
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from fleet.addons.page.view_state import SAMPLE_S, Row, ViewState
from fleet.addons.pictures.look import LABEL_PT, LEGEND_PT, TEXT_PT
from fleet.addons.pictures.shades import union
from fleet.addons.pictures.style import THIN
from fleet.mcap.records import Array
from fleet.palette import COLOURS
from fleet.recorder.scene.link_state import CUT, LinkState
from fleet.recorder.scene.model import LEAST_FLIGHT_S, MOST_FLIGHT_S, STOPS, TRAIL_S, LegendRow
from fleet.recorder.scene.primitives import (
    NED,
    REFERENCE,
    AreaShape,
    CircleShape,
    CrossShape,
    CylinderShape,
    FramePoint,
    LineShape,
    Primitive,
    points_of,
    vehicle_frame,
)
from fleet.recorder.scene.styles import FAULT, NO_AGENT, PACKET, PRINT
from fleet.scenario.sections.vehicle_events import vehicle_events

SCENE_PT = (432.0, 226.0)  # width and height of what is seen of the fleet
MIDDLE_PT = (216.0, 101.0)  # where its middle is: above it stand three lines of text, below it the legend
REACH_PT = 86.0  # from there to the edge of what is to be seen


class Camera:
    """Follows the fleet, and projects places [m, north-east-down] to points of the scene, and their depth of view."""

    def __init__(self, *, above: bool) -> None:
        self.above = above
        self._azimuth, self._elevation = (0.0, pi / 2) if above else (-0.6, 0.5)
        self.centre = np.zeros(3)
        self.radius = 0.0  # of what is to be seen [m]; 0: nothing yet

    def follow(self, points: Array) -> None:
        """Bring points into sight: what is in sight grows and shrinks smoothly, but after a jump."""
        low, high = points.min(axis=0), points.max(axis=0)
        centre, radius = (low + high) / 2, max(2.0, float(np.linalg.norm(high - low)) / 2)
        far = float(np.linalg.norm(centre - self.centre)) > 3 * self.radius
        self.centre = centre
        self.radius = radius if far else self.radius + 0.25 * (radius - self.radius)

    @property
    def scale(self) -> float:
        """Points per m."""
        return REACH_PT / self.radius

    def project(self, places: Any) -> Array:
        """Places (n, 3) as points right, up and away from the eye (n, 3)."""
        north, east, down = (np.asarray(places, float).reshape(-1, 3) - self.centre).T
        ca, sa, ce, se = cos(self._azimuth), sin(self._azimuth), cos(self._elevation), sin(self._elevation)
        away = ca * north - sa * east
        points = np.column_stack([ca * east + sa * north, away * se - down * ce, away * ce + down * se])
        return points * self.scale + (*MIDDLE_PT, 0.0)


TURNS = np.linspace(0.0, 2.0 * np.pi, 37)
OUTLINE = np.array([(0.0, 0.3), (0.1, 0.65), (0.25, 1.0), (0.75, 1.0), (0.92, 0.7), (1.0, 0.0)])  # along, half width


class Canvas:
    """Draws on axes that count in points."""

    def __init__(self, axes: Axes, camera: Camera, size: float) -> None:
        self._axes, self._camera, self.size = axes, camera, size
        self._drawn: list[Artist] = []

    def clear(self) -> None:
        for artist in self._drawn:
            artist.remove()
        self._drawn = []

    def _add(self, artist: Artist) -> None:
        self._axes.add_artist(artist)
        self._drawn.append(artist)

    def lines(self, parts: Sequence[Any], order: float, colours: Any, widths: Any, **style: Any) -> None:
        """Polylines (n, 2 or 3); the first two columns count."""
        segments = [np.asarray(part)[:, :2] for part in parts]
        self._add(LineCollection(segments, colors=colours, linewidths=widths, zorder=order, **style))

    def polygons(self, parts: Sequence[Any], order: float, **style: Any) -> None:
        self._add(PolyCollection(parts, zorder=order, **style))

    def discs(self, points: Sequence[Array], size: float, order: float, **style: Any) -> None:
        """Circles around points, so wide."""
        circles = [Ellipse((float(x), float(y)), size, size) for x, y in points]
        self._add(PatchCollection(circles, zorder=order, **style))

    def crosses(self, points: Sequence[Array], size: float, colour: str) -> None:
        """Where something does not get through."""
        turns = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]]) * size
        self.lines([point + turn for point in points for turn in turns], 4.0, colour, 1.8)

    def text(self, x: float, y: float, text: str, **style: Any) -> None:
        self._drawn.append(self._axes.text(x, y, text, clip_on=True, parse_math=False, **style))

    def paint(self, thing: Primitive, frames: Mapping[str, Array], deep: float) -> None:
        """Paint a primitive. `frames`: where they are [m, NED]. `deep`: where the floor is [m]."""
        colour = PRINT.colour(thing.colour)
        match thing:
            case CylinderShape():
                self._cylinder(thing, colour, deep)
            case CircleShape(at=at):
                style = {"facecolor": "none", "edgecolor": colour, "linewidth": 0.9, "linestyle": "--"}
                self.discs([self._point(at, frames)], 10.0 * self.size, 2.0, **style)
            case CrossShape(at=at):
                x, y = self._point(at, frames)
                self.lines([[(x - 4, y), (x + 4, y)], [(x, y - 4), (x, y + 4)]], 2.0, colour, 1.0)
            case AreaShape(points=points) if all(point.frame in frames for point in points):
                corners = np.array([self._point(point, frames) for point in points])
                style = {"facecolor": to_rgba(colour, 0.13), "edgecolor": to_rgba(colour, 0.7), "linewidth": THIN}
                self.polygons([corners], 1.4, **style)
            case LineShape(points=points) if all(point.frame in frames for point in points):
                places = np.array([self._point(point, frames) for point in points])
                self.lines([places], 1.5, [(colour, 0.5)], THIN, linestyle="--")

    def _point(self, point: FramePoint, frames: Mapping[str, Array]) -> Array:
        return self._camera.project(frames[point.frame] + point[1:])[0, :2]

    def _cylinder(self, thing: CylinderShape, colour: str, deep: float) -> None:
        top = max(0.0, self._camera.centre[2] - 1.5 * self._camera.radius)
        across = thing.north + thing.radius * np.cos(TURNS), thing.east + thing.radius * np.sin(TURNS)
        low, high = (self._camera.project(np.column_stack([*across, np.full_like(TURNS, z)])) for z in (deep, top))
        sides = [np.vstack([low[k : k + 2], high[[k + 1, k]]])[:, :2] for k in range(len(TURNS) - 1)]
        self.polygons(sides, -0.5, facecolor=colour, alpha=0.06)
        ends = [low[:, :2], high[:, :2]]
        self.polygons(ends, -0.5, facecolor=to_rgba(colour, 0.15), edgecolor=colour, linewidth=THIN)


def sample(row: LegendRow) -> Line2D:
    if row.sign == "link":
        colour, width, dash = PRINT.links[LinkState(row.word)]
        return Line2D([], [], color=colour, linewidth=width, linestyle=(0, dash) if dash else "-", label=row.name)
    styles: dict[str, dict[str, Any]] = {
        "packet": {"marker": "o", "markersize": 3, "linestyle": "", "color": PRINT.colour(row.word)},
        "circle": {"marker": "o", "markersize": 7, "linestyle": "", "fillstyle": "none", "color": "0.3"},
        "cylinder": {"marker": "o", "markersize": 7, "linestyle": "", "color": "0.8"},
        "area": {"marker": "P", "markersize": 4, "linestyle": "", "color": PRINT.colour(row.word)},
        "line": {"linestyle": "--", "linewidth": THIN, "color": PRINT.colour(row.word), "alpha": 0.5},
    }
    return Line2D([], [], label=row.name, **styles[row.sign])


def hull(tail: Array, nose: Array, half: float) -> Array:
    along = nose - tail
    aside = np.array([-along[1], along[0]]) / (np.linalg.norm(along) or 1.0) * half
    sides = [tail + share * along + sign * wide * aside for sign in (1, -1) for share, wide in OUTLINE[::sign]]
    return np.array(sides)


def lane(ends: Array, short: float, aside: float) -> Array:
    """The ends of a link, short of the hulls, and beside the lane of the other direction."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along)) or 1.0
    along = along / length
    keep = min(short, 0.4 * length)
    return np.array([ends[0] + keep * along, ends[1] - keep * along]) + aside * np.array([along[1], -along[0]])


def tip(begin: Array, end: Array, size: float) -> Array:
    """The head of an arrow."""
    along = (end - begin) / (np.linalg.norm(end - begin) or 1.0)
    aside = np.array([-along[1], along[0]])
    return np.array([end, end - size * (along + 0.4 * aside), end - size * (along - 0.4 * aside)])


MOST_SIGNALS = 2  # that have a chart of their own
LEFT, RIGHT, BOTTOM, HEIGHT, GAP = 0.06, 0.97, 0.095, 0.15, 0.06  # shares of the figure


class MovieChart:
    """Draws what is known so far, one line per vehicle."""

    def __init__(
        self,
        figure: Figure,
        window: tuple[float, float],
        vehicles: int,
        faults: Sequence[Row],
        signals: Mapping[str, tuple[str, Mapping[int, str]]],
    ) -> None:
        """Draw what stays. `signals`: by their name for all vehicles: the unit, and the names by vehicle."""
        shown = dict(list(signals.items())[:MOST_SIGNALS])
        self._names = {
            name: (each, k) for k, (_, names) in enumerate(shown.values(), 1) for each, name in names.items()
        }
        self._whole = [False] + [True] * len(shown)  # whether all values so far are whole numbers: then they are steps
        labels = [
            "error [m]",
            *(f"{name}{'' if unit in ('', '1') else f' [{unit}]'}" for name, (unit, _) in shown.items()),
        ]
        width = (RIGHT - LEFT - GAP * len(shown)) / len(labels)
        self._axes: list[Axes] = []
        for k, label in enumerate(labels):
            ax = figure.add_axes((LEFT + k * (width + GAP), BOTTOM, width, HEIGHT))
            ax.set(xlim=window, xlabel="time [s]")
            # Above: beside the axis there is no room for the name of a signal.
            ax.set_title(label, loc="left", pad=2.0, size=LABEL_PT, parse_math=False)
            for begin, end in union([(row["from_s"], row["to_s"]) for row in faults]):
                ax.axvspan(begin, end, color="0.88", linewidth=0)
            self._axes.append(ax)
        self._lines = [
            [ax.plot([], [], color=PRINT.vehicle(i), linewidth=1.2)[0] for i in range(1, vehicles + 1)]
            for ax in self._axes
        ]
        self._values: list[list[tuple[list[float], list[float]]]] = [
            [([], []) for _ in range(vehicles)] for _ in self._axes
        ]
        self._now = [ax.axvline(window[0], color="0.3", linewidth=THIN) for ax in self._axes]

    def draw(self, frame: Row) -> None:
        for (times, values), error in zip(self._values[0], frame["errors"], strict=True):
            times.append(frame["t"])
            values.append(np.nan if error is None else error)
        for name, points in frame.get("signals", {}).items():
            if name in self._names:
                i, k = self._names[name]
                times, values = self._values[k][i - 1]
                times += [t for t, _ in points]
                values += [value for _, value in points]
                self._whole[k] &= all(float(value).is_integer() for _, value in points)
        for k, (ax, lines) in enumerate(zip(self._axes, self._lines, strict=True)):
            for line, (times, values) in zip(lines, self._values[k], strict=True):
                line.set_data(times, values)
                line.set_drawstyle("steps-post" if self._whole[k] else "default")
            known = [value for _, values in self._values[k] for value in values if np.isfinite(value)]
            low, high = (0.0, 0.1) if k == 0 else (min(known, default=0.0), max(known, default=1.0))
            high = max(high, *known) if known else high
            margin = 0.08 * (high - low) or 0.5
            ax.set_ylim(0.0 if k == 0 else low - margin, high + margin)
            self._now[k].set_xdata([frame["t"], frame["t"]])


WIDTH_IN, HEIGHT_IN = 6.0, 4.5
LAST_S = 0.2  # of a run, in which its verdict is shown
APART_S = 0.3  # of the movie, between two packets of a link that are shown
PASSED = "#00704A"
DRAWN_COLOURS = (*(colour for colour in COLOURS if colour != "#000000"), PRINT.colour(FAULT))  # beside greys


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
        picture: ViewState,
        begin_s: float,
        end_s: float,
        rate: float,
        *,
        above: bool,
        verdict: Row | None = None,
        charted: Mapping[str, tuple[str, Mapping[int, str]]] | None = None,
    ) -> None:
        """Draw what stays. `begin_s`, `end_s`: in simulated time. `rate`: simulated seconds per second of the movie.
        `verdict`: on the run, shown at the end: its `text`, and whether it has `passed`. `charted`: as `MovieChart`
        takes it."""
        self._setup, self._begin_s, self._rate = picture.setup(), begin_s, rate
        self._picture, self._model = picture, picture.scene
        self._end_s = end_s
        self._happened = picture.happenings  # of the whole log
        self._camera = Camera(above=above)
        self._trails: dict[int, deque[list[float]]] = {}
        self._flying: list[_Flight] = []
        self._rings: dict[tuple[int, float], tuple[float, float]] = {}  # by sender and time: from when to when [s]
        self._shown_s = [-APART_S] * len(self._model.links)  # when the last packet of a link was shown [s of the movie]
        self.figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
        FigureCanvasAgg(self.figure)
        self._corners: dict[int, int] = {}  # of labels, by vehicle
        self._make_scene()
        self._make_texts(verdict)
        self._chart = MovieChart(
            self.figure, (begin_s, end_s), self._setup["vehicles"], picture.known_faults, charted or {}
        )

    def _make_scene(self) -> None:
        axes = self.figure.add_axes((0.0, 0.28, 1.0, SCENE_PT[1] / 72.0 / HEIGHT_IN))
        axes.set(xlim=(0.0, SCENE_PT[0]), ylim=(0.0, SCENE_PT[1]))
        axes.set_axis_off()
        handles = [sample(row) for row in self._model.legend()]
        axes.legend(handles=handles, loc="lower left", ncols=len(handles), borderpad=0.2, handletextpad=0.5,
                    columnspacing=0.7, fontsize=LABEL_PT, handlelength=1.8)  # fmt: skip
        size = 0.4 if self._setup["crowd"] else 0.7 if self._setup["many"] else 1.0
        self._canvas = Canvas(axes, self._camera, size)

    def _make_texts(self, verdict: Row | None) -> None:
        name, fault = _short(self._setup["scenario"], 50), PRINT.colour(FAULT)
        self.figure.text(0.02, 0.95, name, size=TEXT_PT + 2, weight="bold", parse_math=False)
        self._verdict = self.figure.text(0.7, 0.95, "", weight="bold", ha="right", parse_math=False)
        if verdict is not None:
            self._verdict.set_color({True: PASSED, False: fault, None: "0.4"}[verdict["passed"]])
        self._said = "" if verdict is None else verdict["text"]
        self._clock = self.figure.text(0.98, 0.95, "", size=TEXT_PT + 2, weight="bold", ha="right")
        self._faults = self.figure.text(0.02, 0.905, "", color=fault, weight="bold", parse_math=False)
        self._events = self.figure.text(0.02, 0.87, "", color="0.25", parse_math=False)
        self.figure.text(0.98, 0.905, f"{self._rate:.3g} x real time", size=LEGEND_PT, color="0.4", ha="right")

    def remember(self, history: Row) -> None:
        """Take the way that the vehicles have come before the first picture."""
        for row in history["samples"]:
            for i, *place in np.reshape(row[4], (-1, 4)).tolist():
                self._trails.setdefault(int(i), deque(maxlen=int(TRAIL_S / SAMPLE_S))).append(place)

    def draw(self, frame: Row, at_s: float) -> None:
        """Draw a frame. `frame`: as `ViewState.frame` gives it, of now. `at_s`: its time in the movie."""
        canvas, camera = self._canvas, self._camera
        canvas.clear()
        self.remember(frame)
        if not self._setup["crowd"]:  # else nobody could follow them
            self._take_packets(frame["packets"], at_s)
        self._write(frame)
        self._chart.draw(frame)
        rows = {row[0]: row for row in frame["uuv"]}
        frames = {NED: np.zeros(3), REFERENCE: np.array(frame["ref"])}
        frames |= {vehicle_frame(i): np.array(row[1:4]) for i, row in rows.items()}
        moving = self._picture.moving()
        points = [point for thing in moving for point in points_of(thing) if point.frame in frames]
        seen = np.array([*(row[1:4] for row in rows.values()), *(frames[one.frame] + one[1:] for one in points)])
        camera.follow(seen)
        deep = seen[:, 2].max() + 0.35 * camera.radius
        self._draw_floor(deep)
        self._draw_compass()
        if not camera.above:
            stems = [camera.project([row[1:4], [*row[1:3], deep]]) for row in rows.values()]
            canvas.lines(stems, 0.0, "0.7", THIN)
        self._draw_trails(rows)
        for thing in (*self._model.standing, *moving):
            canvas.paint(thing, frames, deep)
        self._draw_rings(rows, at_s)
        lanes = self._draw_links(rows, frame["links"])
        self._draw_packets(lanes, at_s)
        self._draw_hulls(rows, frame, [ends for ends in lanes if ends is not None])

    def _write(self, frame: Row) -> None:
        self._clock.set_text(f"t = {frame['t']:.1f} s")
        if frame["t"] >= self._end_s - LAST_S:  # earlier it is not known
            self._verdict.set_text(self._said)
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
        self._canvas.lines(parts, -1.0, "0.9", 0.5, antialiased=False)  # which makes a GIF a quarter smaller
        self._canvas.text(SCENE_PT[0] - 8, 6, f"grid {step:g} m", size=LABEL_PT, color="0.35", ha="right")

    def _draw_compass(self) -> None:
        north, east, down = self._camera.centre
        origin, ahead = self._camera.project([(north, east, down), (north + 1.0, east, down)])[:, :2]
        x, y = SCENE_PT[0] - 24.0, 32.0
        along = (ahead - origin) / (np.linalg.norm(ahead - origin) or 1.0)
        begin, end = np.array([x, y]) - 9 * along, np.array([x, y]) + 9 * along
        self._canvas.lines([[begin, end]], 1.0, "0.3", 1.2)
        self._canvas.polygons([tip(begin, end, 5.0)], 1.0, facecolor="0.3")
        x, y = end + 6 * along
        self._canvas.text(x, y, "N", size=LABEL_PT, weight="bold", ha="center", va="center")

    def _draw_trails(self, rows: dict[int, list[Any]]) -> None:
        parts, colours = [], []
        for i, row in rows.items():
            points = self._camera.project([*self._trails.get(i, ()), row[1:4]])
            size = -(-len(points) // 6)
            for k in range(0, len(points) - 1, size):
                parts.append(points[k : k + size + 1])
                colours.append((PRINT.vehicle(i), 0.12 + 0.5 * k / len(points)))
        self._canvas.lines(parts, 1.0, colours, 1.2)

    def _draw_links(self, rows: dict[int, list[Any]], states: list[str]) -> list[Array | None]:
        lanes: list[Array | None] = []
        by_state: dict[LinkState, list[Array]] = {}
        canvas, size = self._canvas, self._canvas.size
        for link, state in zip(self._model.links, states, strict=True):
            src, dst = link
            if src not in rows or dst not in rows:
                lanes.append(None)
                continue
            ends = self._camera.project([rows[src][1:4], rows[dst][1:4]])[:, :2]
            beside = lane(ends, 13.0 * size, 3.0 * size if link in self._model.both_ways else 0.0)
            lanes.append(beside)
            by_state.setdefault(LinkState(state), []).append(beside)
        for state, some in by_state.items():
            colour, width, dash = PRINT.links[state]
            alpha = 0.6 if state == LinkState.DELIVERING else 0.95
            canvas.lines(some, 3.0, colour, width * max(0.7, size), linestyle=(0, dash) if dash else "-", alpha=alpha)
            tips = [tip(ends[0], ends[1], (4.0 + width) * size) for ends in some]
            canvas.polygons(tips, 3.0, facecolor=colour, alpha=alpha)
            if state == LinkState.CUT:
                canvas.crosses([ends.mean(axis=0) for ends in some], 3.5 * size, colour)
        return lanes

    def _take_packets(self, packets: list[list[Any]], now_s: float) -> None:
        """Of each link as many as the eye can follow; what became of one is known when it has arrived or is lost."""
        for link, sent_s, late_s, fate in packets:
            begin_s = (sent_s + max(late_s, 0.0) - self._begin_s) / self._rate
            if begin_s >= self._shown_s[link] + APART_S:
                self._shown_s[link] = begin_s
                lasts_s = min(MOST_FLIGHT_S, max(LEAST_FLIGHT_S, late_s / self._rate))
                self._flying.append(_Flight(link, begin_s, begin_s + lasts_s, fate))
                if self._setup["acoustic"] and fate != CUT:
                    self._rings[self._model.links[link][0], sent_s] = begin_s, begin_s + lasts_s
        self._flying = [flight for flight in self._flying if flight.end_s > now_s]
        self._rings = {sent: span for sent, span in self._rings.items() if span[1] > now_s}

    def _draw_rings(self, rows: dict[int, list[Any]], now_s: float) -> None:
        """Sound that spreads from who sends: at the end as wide as the farthest place in sight."""
        circles, colours = [], []
        for (src, _), (begin_s, end_s) in self._rings.items():
            share = (now_s - begin_s) / (end_s - begin_s)
            if share < 0.0 or src not in rows:
                continue
            north, east, down = rows[src][1:4]
            radius = share * 2.0 * self._camera.radius
            places = [north + radius * np.cos(TURNS), east + radius * np.sin(TURNS), np.full_like(TURNS, down)]
            circles.append(self._camera.project(np.column_stack(places)))
            colours.append(to_rgba(PRINT.links[LinkState.DELIVERING].colour, 0.7 * (1.0 - share)))
        self._canvas.lines(circles, 2.0, colours, 1.2)

    def _draw_packets(self, lanes: list[Array | None], now_s: float) -> None:
        canvas = self._canvas
        by_colour: dict[str, list[Array]] = {}
        for link, begin_s, end_s, fate in self._flying:
            share = (now_s - begin_s) / (end_s - begin_s)
            ends, stop = lanes[link], STOPS.get(fate, 1.0)
            if ends is None or share < 0.0:
                continue
            colour = PRINT.colour(f"{PACKET} {fate}")
            point = ends[0] + min(share, stop) * (ends[1] - ends[0])
            if share > stop:
                canvas.crosses([point], 2.0 * canvas.size, colour)
            else:
                by_colour.setdefault(colour, []).append(point)
        for colour, points in by_colour.items():
            canvas.discs(points, 4.0 * canvas.size, 5.0, facecolor=colour, edgecolor="white", linewidth=0.4)

    def _draw_hulls(self, rows: dict[int, list[Any]], frame: Row, lanes: list[Array]) -> None:
        camera, least = self._camera, 26.0 * self._canvas.size
        places = {i: camera.project(row[1:4])[0] for i, row in rows.items()}
        hulls, colours = [], []
        for i in sorted(rows, key=lambda i: -float(places[i][2])):
            length, width = self._setup["hulls_m"][i - 1]
            drawn = max(length, least / camera.scale)
            thick = max(width * drawn / length * camera.scale, 0.22 * least)
            ends = camera.project(_axis(rows[i], drawn))[:, :2]
            hulls.append(hull(ends[0], ends[1], thick / 2))
            colours.append(PRINT.colour(NO_AGENT) if i in frame["no_agent"] else PRINT.vehicle(i))
        self._canvas.polygons(hulls, 6.0, facecolor=colours, edgecolor="white", linewidth=0.6)
        shares = np.linspace(0.0, 1.0, 12)[:, None]
        links = np.concatenate([np.empty((0, 2)), *(a + shares * (b - a) for a, b in lanes)])
        for i, name, depth in frame["labels"]:
            if i in frame["labelled"] and i in places:
                wide = max(0.65 * TEXT_PT * len(name), 0.55 * LABEL_PT * len(depth))
                at = self._corner(i, places[i][:2], wide, links)
                self._draw_label(i, name, depth, at, ill=i in frame["states"])

    def _corner(self, i: int, at: Array, wide: float, links: Array) -> Array:
        """Where the label of a vehicle begins: right above its hull, or where it hides less of links and is not cut; it
        stays where it was if that is as good. `links`: points on them."""
        left = -12.0 - wide
        corners = at + np.array([(8.0, 10.0), (left, 10.0), (8.0, -18.0), (left, -18.0)])
        least, most = corners - np.array([3.0, 12.0]), corners + np.array([wide + 3.0, 10.0])
        hidden = ((links > least[:, None]) & (links < most[:, None])).all(axis=2).sum(axis=1)
        costs = hidden + 1000 * ((least < 0.0) | (most > SCENE_PT)).any(axis=1)
        last = self._corners.get(i, 0)
        self._corners[i] = last if costs[last] == costs.min() else int(costs.argmin())
        return np.asarray(corners[self._corners[i]])

    def _draw_label(self, i: int, name: str, depth: str, at: Array, *, ill: bool) -> None:
        x, y = at.tolist()
        face, colour = (PRINT.colour(FAULT), "white") if ill else ("white", PRINT.vehicle(i))
        box = {"boxstyle": "round,pad=0.2", "facecolor": face, "edgecolor": "none", "alpha": 0.85}
        self._canvas.text(x, y, name, size=TEXT_PT, weight="bold", color=colour, bbox=box, zorder=7)
        if depth:
            ground = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
            self._canvas.text(x, y - 9, depth, size=LABEL_PT, color="0.35", bbox=ground, zorder=6.9)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 4]} ..."


def _step(value: float) -> float:
    power = 10.0 ** floor(log10(value))
    return power * max(digit for digit in (1.0, 2.0, 5.0) if digit * power <= value)


def _axis(row: list[Any], length: float) -> Array:
    north, east, down, pitch, heading = row[1:6]
    half = length / 2 * np.array([cos(pitch) * cos(heading), cos(pitch) * sin(heading), -sin(pitch)])
    place = np.array([north, east, down])
    return np.array([place - half, place + half])
