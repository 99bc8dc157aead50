"""Where the vehicles went: from above, east to the right and north up, and in three dimensions, depth downwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from fleet.addons.pictures.axes import (
    MOST_NAMED,
    colours_of_vehicles,
    entries_of_runs,
    marks_legend,
    outliers,
    spread,
    vehicle_colours,
)
from fleet.addons.pictures.beliefs import beliefs
from fleet.addons.pictures.caption import write_caption
from fleet.addons.pictures.look import column_in, label_pt
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View, first_words
from fleet.addons.pictures.style import NORMAL, STYLES, THIN
from fleet.mcap.records import Array
from fleet.palette import COLOURS
from fleet.recorder.scene.belief import ellipse
from fleet.recorder.scene.model import SceneModel
from fleet.recorder.scene.primitives import AreaShape, CylinderShape, LineShape, Primitive
from fleet.recorder.scene.styles import COURSE, PRINT
from fleet.scenario.sections.fault_entry import DIVERGED, TUMBLED, entry_kind, entry_vehicles

MOMENTS = 5
STRETCHES = 40  # of a way in three dimensions
_ELLIPSE_LINE: dict[str, Any] = {"linewidth": 0.6, "linestyle": (0, (2, 1))}
_AREA: dict[str, Any] = {"alpha": 0.2, "linewidth": 0.5, "zorder": 1.5}
BELIEF_ENTRIES: list[Artist] = [  # of a legend
    Line2D([], [], label="as believed", **_ELLIPSE_LINE, color="0.3"),
    Patch(label="95 % ellipse", color="0.3", alpha=_AREA["alpha"]),
]


class BelievedWay(NamedTuple):
    """Where a vehicle believed that it was, beside where it was: a thin way, and an ellipse at a few moments."""

    vehicle: int
    colour: str
    positions: Array  # (samples, 3) [m, NED]
    ellipses: list[AreaShape]


def believed_way(run: LoggedRun, i: int, colour: str, view: View) -> BelievedWay | None:
    """The beliefs of vehicle i in the window of a picture; None: it knew where it was, or the log has no beliefs."""
    known, state = beliefs(run.log, i), f"uuv/{i}/state"
    if known is None or state not in run.log or not len(run.log[state]):
        return None
    true, (first, last) = run.log[state], view.window or (0.0, run.log.end)
    inside = np.flatnonzero((known.t >= first) & (known.t <= last))
    if not len(inside):
        return None
    t = known.t[inside]
    positions = np.column_stack([np.interp(t, true.t, true[name]) for name in ("x", "y", "z")]) + known.off[inside]
    moments = [min(int(np.searchsorted(t, at)), len(t) - 1) for at in np.linspace(first, last, MOMENTS)]
    ellipses = [ellipse(i, positions[k].tolist(), known.covariance[inside[k]].tolist()) for k in dict.fromkeys(moments)]
    return BelievedWay(i, colour, positions, [one for one in ellipses if one is not None])


def draw_ways(ax: Axes, ways: Sequence[BelievedWay]) -> None:
    for way in ways:
        p, gid = way.positions, f"belief-{way.vehicle}"
        ax.plot(p[:, 1], p[:, 0], color=way.colour, zorder=2.2, gid=gid, **_ELLIPSE_LINE)
        for one in way.ellipses:
            norths, easts = [point.north for point in one.points], [point.east for point in one.points]
            ax.fill(easts, norths, color=way.colour, gid=f"ellipse-{way.vehicle}", **_AREA)


def draw_ways_in_space(ax: Any, ways: Sequence[BelievedWay]) -> None:
    """Draw them in three dimensions; an ellipse lies at the depth that the vehicle believes.

    Depth is exaggerated, so the noise of its sensor would hide everything: the line joins means of short stretches.
    """
    for way in ways:
        p = np.array([part.mean(axis=0) for part in np.array_split(way.positions, STRETCHES) if len(part)])
        ax.plot(p[:, 1], p[:, 0], p[:, 2], color=way.colour, gid=f"belief-{way.vehicle}", **_ELLIPSE_LINE)
        for one in way.ellipses:
            corners = [[(point.east, point.north, point.down) for point in one.points]]
            style = {"facecolor": way.colour, "edgecolor": way.colour, "gid": f"ellipse-{way.vehicle}"}
            ax.add_collection3d(Poly3DCollection(corners, **style, **_AREA))


# Kind of a fault, or what befell a vehicle -> (what became of it, mark).
MARKS = {"kill": ("agent dead", "X"), TUMBLED: (TUMBLED, "*"), DIVERGED: (DIVERGED, "P")}
_ARROWS = 3  # per track


class Happening(NamedTuple):
    """An event of a vehicle."""

    vehicle: int
    what: str  # agent dead, tumbled, diverged
    mark: str
    t: float  # s
    position: Array  # m, NED


def happenings(run: LoggedRun, view: View, tracks: Mapping[int, tuple[Array, Array]]) -> list[Happening]:
    """The events of the vehicles in a picture, in the order of time. `tracks`: times [s] and positions (samples, 3) [m,
    NED] of each vehicle.
    """
    found = []
    for fault in (*run.log.faults, *run.log.events):
        kind = entry_kind(fault.entry)
        for i in entry_vehicles(fault.entry) if kind in MARKS else ():
            if i in tracks and (view.window is None or view.window[0] <= fault.begin <= view.window[1]):
                t, positions = tracks[i]
                k = min(int(np.searchsorted(t, fault.begin)), len(t) - 1)
                found.append(Happening(i, *MARKS[kind], fault.begin, positions[k]))
    return sorted(found, key=lambda one: (one.t, one.vehicle))


def captions(found: Sequence[Happening]) -> list[str]:
    """A line such as `tumbled: UUV 2 at 27.7 s (3 times), UUV 3 at 26.3 s` for each kind."""
    lines = []
    for what in dict.fromkeys(one.what for one in found):
        times: dict[int, list[float]] = {}
        for one in found:
            if one.what == what:
                times.setdefault(one.vehicle, []).append(one.t)
        often = {i: f" ({len(t)} times)" if len(t) > 1 else "" for i, t in times.items()}
        each = [f"UUV {i} at {t[0]:.4g} s{often[i]}" for i, t in times.items()]
        lines += [f"{what}: {first_words(each[k : k + 2], 2)}" for k in range(0, min(len(each), 6), 2)]
        if len(each) > 6:
            lines.append(f"{what}: {len(each) - 6} more")
    return lines


def directions(positions: Array) -> list[tuple[Array, float]]:
    """(position [m, NED], course [degrees from east to north]) at a few places along a track, evenly by its length."""
    steps = np.linalg.norm(np.diff(positions[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    if along[-1] < 1.0:  # m: it stays where it is
        return []
    found = []
    for share in (np.arange(_ARROWS) + 0.5) / _ARROWS:
        k = int(np.clip(np.searchsorted(along, share * along[-1]), 1, len(positions) - 1))
        back = max(int(np.searchsorted(along, along[k] - 0.01 * along[-1])) - 1, 0)
        north, east = positions[k, :2] - positions[back, :2]
        found.append((positions[k], float(np.degrees(np.arctan2(north, east)))))
    return found


def places(run: LoggedRun, view: View) -> dict[int, Array]:
    """Where each vehicle should be at the end of the picture [m, NED]."""
    if run.scenario is None:
        return {}
    t = min(view.window[1] if view.window else run.log.end, run.log.end)
    scene = SceneModel(run.scenario)
    reference, offsets = np.array(scene.reference(t)), scene.offsets(t)
    return {i: reference + np.array(offsets[i - 1]) for i in run.vehicles(view) if i <= len(offsets)}


SHAPES = 5  # moments at which the formation is drawn
GREY = "0.6"
CROWD = 40  # with more vehicles than this only the named ones are numbered and have marks
_MOST_EDGES = 60  # of the graph that are drawn as the formation's shape
_BESIDE = 20  # characters of an entry of the legend, at most, if it stands beside the tracks
_TALL = 1.3  # times as high as wide: then the legend stands beside the tracks
_EXAGGERATIONS = (1, 2, 5, 10, 20, 50, 100)
_MARK = 3.5  # pt
_TWO_DIGITS = 6.5  # pt, for half a depth of two digits
_ZOOMS = (0.85, 0.8, 0.75, 0.7, 0.65, 0.6)  # of a picture in three dimensions
_FAINT: dict[str, Any] = {"linewidths": 0.3, "alpha": 0.4, "zorder": 2, "gid": "others"}
_CYLINDER: dict[str, Any] = {"facecolor": "0.85", "edgecolor": "0.4", "linewidth": 0.5, "zorder": 1, "gid": "obstacle"}
_LINE: dict[str, Any] = {"color": PRINT.colour(COURSE), "linewidth": THIN, "linestyle": ":", "gid": "reference"}
_DOTS: dict[str, Any] = {"s": 1.5, "linewidths": 0, "zorder": 2, "gid": "ends"}


class VehicleTrack(NamedTuple):
    """A vehicle's way, and how it is drawn."""

    run: LoggedRun
    vehicle: int
    t: Array  # s
    positions: Array  # (samples, 3) [m, NED]
    colour: str
    style: Any


def top(runs: Sequence[LoggedRun], view: View) -> Figure:
    """North over east, to scale."""
    tracks, entries = _tracks(runs, view)
    wanted = [places(run, view) for run in runs]
    ways = _believed_ways(tracks, view)
    seen = [*(track.positions for track in tracks), *(way.positions for way in ways)]
    low, high = _extent([*seen, *(np.array([*w.values()]) for w in wanted if w)])
    figure, ax, tall = _sheet(low, high)
    edges = [edge for run in runs for edge in _shapes(run, view)]
    for a, b in edges:
        ax.plot([a[1], b[1]], [a[0], b[0]], color="0.78", linewidth=0.5, zorder=1, gid="formation")
    standing = _standing(runs, view)
    for thing in standing:
        _paint(ax, thing)
    distinct = _draw_from_above(ax, tracks)
    draw_ways(ax, [way for way in ways if way.vehicle in distinct])
    for place in (place for w in wanted for i, place in w.items() if i in distinct):
        ax.plot(place[1], place[0], "+", color="black", markersize=6, markeredgewidth=THIN, zorder=5, gid="place")
    happened = _happenings(runs, view, tracks)
    for one, colour in happened:
        ax.plot(one.position[1], one.position[0], one.mark, color=colour, markeredgecolor="black", markeredgewidth=0.5,
                markersize=6, zorder=6, gid=f"{one.what}-{one.vehicle}")  # fmt: skip
    entries += _legend_entries(happened, runs, standing, linked=bool(edges), flat=True)
    entries += BELIEF_ENTRIES if ways else []
    _finish(figure, runs, [one for one, _ in happened], [])
    tall &= max(len(str(entry.get_label())) for entry in entries) <= _BESIDE
    if tall:
        legend = figure.legend(handles=entries, loc="outside right upper", handlelength=1.8)
        for text in legend.get_texts():
            text.set_parse_math(False)
        figure.draw_without_rendering()
        tall = figure.get_tightbbox().x0 >= 0.0
        if not tall:  # no room is left for the tracks
            legend.remove()
            figure.legends.clear()
    if not tall:
        marks_legend(figure, entries)
    return figure


def _sheet(low: Array, high: Array) -> tuple[Figure, Axes, bool]:
    tall = (high - low)[0] > _TALL * (high - low)[1]
    room = 1.7 if tall else 2.85  # in, for the axes
    height = float(np.clip(room * (high - low)[0] / (high - low)[1], 1.0, 4.2))
    figure = Figure(figsize=(column_in(), height + (0.75 if tall else 1.0)), layout="compressed")
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    ax.set_xlim(low[1], high[1])
    ax.set_ylim(low[0], high[0])
    ax.set_aspect("equal", adjustable="box")
    ax.xaxis.set_major_locator(MaxNLocator(4 if tall else 6))
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    return figure, ax, tall


def _paint(ax: Any, thing: Primitive) -> None:
    match thing:
        case CylinderShape(north=north, east=east, radius=radius):
            ax.add_patch(Circle((east, north), radius, **_CYLINDER))
        case LineShape(points=points):
            ax.plot([p.east for p in points], [p.north for p in points], **_LINE, zorder=1)


def _draw_from_above(ax: Axes, tracks: list[VehicleTrack]) -> set[int]:
    """The ways; returns the vehicles that are drawn one by one."""
    many = len({track.vehicle for track in tracks}) > MOST_NAMED
    others, distinct = _divide_tracks(tracks)
    if others:
        colours = [track.colour for track in others]
        lines: Any = [track.positions[:, 1::-1] for track in others]
        ax.add_collection(LineCollection(lines, colors=colours, **_FAINT))
        last = _ends(others)
        ax.scatter(last[:, 1], last[:, 0], c=colours, **_DOTS)
    for track in distinct:
        p, colour, gid = track.positions, track.colour, f"vehicle-{track.vehicle}"
        above = 2.0 if colour == GREY else 2.5
        ax.plot(p[:, 1], p[:, 0], color=colour, linestyle=track.style, linewidth=THIN if many else NORMAL, zorder=above,
                gid=gid)  # fmt: skip
        ax.plot(p[0, 1], p[0, 0], "o", color=colour, markersize=_MARK, markerfacecolor="white", zorder=above + 1)
        ax.plot(p[-1, 1], p[-1, 0], "o", color=colour, markersize=_MARK, zorder=above + 1)
        for place, course in directions(p):
            ax.plot(place[1], place[0], marker=(3, 0, course - 90.0), color=colour, markersize=4.5, linestyle="",
                    markeredgewidth=0.0, zorder=above + 1, gid=f"direction-{track.vehicle}")  # fmt: skip
        if many:
            ax.annotate(str(track.vehicle), (p[-1, 1], p[-1, 0]), xytext=(3, 1), textcoords="offset points",
                        fontsize=label_pt(), color="0.25", gid="number")  # fmt: skip
    return {track.vehicle for track in distinct}


def _believed_ways(tracks: list[VehicleTrack], view: View) -> list[BelievedWay]:
    found = (believed_way(track.run, track.vehicle, track.colour, view) for track in tracks)
    return [way for way in found if way is not None]


def space(runs: Sequence[LoggedRun], view: View) -> Figure:
    """East, north and depth; east and north have one scale, and it is said how much larger that of depth is."""
    tracks, entries = _tracks(runs, view)
    standing = _standing(runs, view)
    courses = [np.array([point[1:] for point in thing.points]) for thing in standing if isinstance(thing, LineShape)]
    ways = _believed_ways(tracks, view)
    low, high = _extent([*(track.positions for track in tracks), *(way.positions for way in ways), *courses])
    figure = Figure(figsize=(column_in(), 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    ax: Any = figure.add_subplot(projection="3d")
    factor, sides = _turn(ax, low, high)
    edges = [edge for run in runs for edge in _shapes(run, view)]
    for a, b in edges:
        ax.plot([a[1], b[1]], [a[0], b[0]], [a[2], b[2]], color="0.78", linewidth=0.5, gid="formation")
    for thing in standing:
        _paint_in_space(ax, thing)
    distinct = _draw_in_space(ax, tracks)
    draw_ways_in_space(ax, [way for way in ways if way.vehicle in distinct])
    happened = _happenings(runs, view, tracks)
    for one, colour in happened:
        x, y, z = one.position
        ax.plot([y], [x], [z], one.mark, color=colour, markeredgecolor="black", markeredgewidth=0.5, markersize=6,
                gid=f"{one.what}-{one.vehicle}")  # fmt: skip
    entries += _legend_entries(happened, runs, standing, linked=bool(edges), flat=False)
    entries += BELIEF_ENTRIES if ways else []
    scale = f"depth exaggerated {factor} times" if factor > 1 else "depth to scale"
    _finish(figure, runs, [one for one, _ in happened], [scale])
    marks_legend(figure, entries)
    _keep_inside(figure, ax, sides)
    return figure


def _keep_inside(figure: Figure, ax: Any, sides: Sequence[float]) -> None:
    """Leave room for the depths beside their axis, and make the box smaller until all labels are inside the figure,
    which the layout of a figure does not for axes in three dimensions.
    """
    figure.draw_without_rendering()
    widest = max((text.get_window_extent().width for text in ax.get_zticklabels()), default=0.0)
    half = 0.5 * widest * 72.0 / figure.dpi  # pt: they stand around a point beside the axis
    ax.tick_params(axis="z", pad=half - _TWO_DIGITS)
    ax.zaxis.labelpad += max(0.0, 2.0 * (half - _TWO_DIGITS + 1.0))
    for zoom in _ZOOMS:
        ax.set_box_aspect(sides, zoom=zoom)
        figure.draw_without_rendering()
        found = [axis.label.get_window_extent() for axis in (ax.xaxis, ax.yaxis, ax.zaxis)]
        if min(box.x0 for box in found) > 0.0 and max(box.x1 for box in found) < figure.bbox.width:
            break
    _cut_blank(figure, ax)


def _cut_blank(figure: Figure, ax: Any) -> None:
    """Make the figure lower by what is blank above and below the box, whose axes are a square."""
    figure.draw_without_rendering()
    corners = np.array(list(product(ax.get_xlim(), ax.get_ylim(), ax.get_zlim())))
    x, y, _ = proj_transform(*corners.T, ax.get_proj())
    points = ax.transData.transform(np.column_stack([x, y]))
    labels = [axis.get_tightbbox() for axis in (ax.xaxis, ax.yaxis, ax.zaxis)]
    drawn = Bbox.union([Bbox([points.min(axis=0), points.max(axis=0)]), *labels])
    (left, bottom, wide, high), (width, height) = ax.bbox.bounds, figure.bbox.size
    lower = height - max(0.0, high - drawn.height)
    figure.set_layout_engine("none")
    figure.set_figheight(lower / figure.dpi)
    ax.set_position((left / width, (2.0 * bottom - drawn.y0) / lower, wide / width, high / lower))


def _turn(ax: Any, low: Array, high: Array) -> tuple[int, list[float]]:
    """Let the axes show all of it; returns how many times larger depth is drawn than the plane, and its sides."""
    across = high - low
    across[2] = max(across[2], 0.5)  # m: otherwise a flat course looks rough
    factor = exaggeration(max(across[:2]), across[2])
    ax.set_xlim(low[1], high[1])
    ax.set_ylim(low[0], high[0])
    ax.set_zlim((low[2] + high[2] + across[2]) / 2, (low[2] + high[2] - across[2]) / 2)  # down is down
    ax.set_xlabel("east [m]", labelpad=0)
    ax.set_ylabel("north [m]", labelpad=0)
    ax.set_zlabel("depth [m]", labelpad=-1)
    ax.tick_params(pad=-2)
    for axis, length in ((ax.xaxis, across[1]), (ax.yaxis, across[0]), (ax.zaxis, factor * across[2])):
        axis.set_major_locator(MaxNLocator(4 if length > 0.4 * max(across[:2]) else 2))
    # The longer side to the right, so that the box fills the picture.
    ax.view_init(elev=28, azim=-60 if across[1] >= across[0] else -25)
    ax.autoscale(False)
    return factor, [across[1], across[0], factor * across[2]]


def _paint_in_space(ax: Any, thing: Primitive) -> None:
    match thing:
        case CylinderShape(north=north, east=east, radius=radius):
            turns = np.linspace(0.0, 2.0 * np.pi, 37)
            x, y = east + radius * np.cos(turns), north + radius * np.sin(turns)
            ends = ax.get_zlim()
            faces = [np.column_stack([x, y, np.full_like(x, z)]) for z in ends]
            ax.add_collection3d(Poly3DCollection(faces, alpha=0.5, **_CYLINDER))
            for k in range(0, 36, 9):
                ax.plot([x[k]] * 2, [y[k]] * 2, ends, color=_CYLINDER["edgecolor"], linewidth=_CYLINDER["linewidth"])
        case LineShape(points=points):
            ax.plot(*zip(*((p.east, p.north, p.down) for p in points), strict=True), **_LINE)


def _draw_in_space(ax: Any, tracks: list[VehicleTrack]) -> set[int]:
    """The ways, with their beginnings and ends; returns the vehicles that are drawn one by one."""
    others, distinct = _divide_tracks(tracks)
    if others:
        colours = [track.colour for track in others]
        lines = [track.positions[:, [1, 0, 2]] for track in others]
        ax.add_collection3d(Line3DCollection(lines, colors=colours, **_FAINT))
        ax.scatter(*_ends(others)[:, [1, 0, 2]].T, c=colours, **_DOTS)
    for track in distinct:
        p, colour = track.positions, track.colour
        ax.plot(p[:, 1], p[:, 0], p[:, 2], color=colour, linestyle=track.style, linewidth=NORMAL,
                gid=f"vehicle-{track.vehicle}")  # fmt: skip
        ax.plot(p[:1, 1], p[:1, 0], p[:1, 2], "o", color=colour, markersize=_MARK, markerfacecolor="white")
        ax.plot(p[-1:, 1], p[-1:, 0], p[-1:, 2], "o", color=colour, markersize=_MARK)
    return {track.vehicle for track in distinct}


def exaggeration(across: float, deep: float) -> int:
    """How many times larger depth is drawn than the plane, so that it can be seen: a round number, at least 1."""
    return max((f for f in _EXAGGERATIONS if f * deep <= 0.6 * across), default=1)


def _tracks(runs: Sequence[LoggedRun], view: View) -> tuple[list[VehicleTrack], list[Artist]]:
    found: list[VehicleTrack] = []
    for run in runs:
        for i in run.vehicles(view):
            topic = f"uuv/{i}/state"
            if topic not in run.log or not len(run.log[topic]):
                continue
            state = run.log[topic]
            first, last = view.window or (-np.inf, np.inf)
            inside = (state.t >= first) & (state.t <= last)
            positions = np.column_stack([state["x"], state["y"], state["z"]])[inside]
            if len(positions):
                found.append(VehicleTrack(run, i, state.t[inside], positions, GREY, "-"))
    if not found:
        raise NothingToDraw("the log has no state of a vehicle in that time")
    shown = sorted({track.vehicle for track in found})
    if len(runs) > 1:
        own = colours_of_vehicles(runs, view)
        look = {id(run): (COLOURS[r % len(COLOURS)], STYLES[r % len(STYLES)]) for r, run in enumerate(runs)}
        drawn = [t._replace(colour=own.get(t.vehicle, look[id(t.run)][0]), style=look[id(t.run)][1]) for t in found]
        return drawn, entries_of_runs(runs, own)
    named = shown if len(shown) <= MOST_NAMED else _worst(runs[0], shown)
    of = vehicle_colours(named)
    entries: list[Artist] = [Line2D([], [], color=colour, label=runs[0].vehicle_label(i)) for i, colour in of.items()]
    if len(named) < len(shown):
        entries.append(Line2D([], [], color=GREY, linewidth=THIN, label=f"{len(shown) - len(named)} others"))
    return [track._replace(colour=of.get(track.vehicle, GREY)) for track in found], entries


def _worst(run: LoggedRun, shown: Sequence[int]) -> list[int]:
    errors = {i: run.series(i, "error", "formation_norm") for i in shown}
    known = {i: (one[0], one[1][:, 0]) for i, one in errors.items() if one is not None}
    return sorted(outliers([spread(known)], log=True)) if known else []


def _divide_tracks(tracks: list[VehicleTrack]) -> tuple[list[VehicleTrack], list[VehicleTrack]]:
    """The tracks that are drawn together because they are many, and those that are drawn one by one, which the legend
    names.
    """
    if len({track.vehicle for track in tracks}) <= CROWD:
        return [], tracks
    named = [track for track in tracks if track.colour != GREY]
    return ([track for track in tracks if track.colour == GREY], named) if len(named) < len(tracks) else (tracks, [])


def _ends(tracks: Sequence[VehicleTrack]) -> Array:
    return np.array([track.positions[-1] for track in tracks])


def _extent(positions: Sequence[Array]) -> tuple[Array, Array]:
    """The least and greatest north, east and down [m], with a margin; never more than three times as long as wide."""
    together = np.concatenate(positions)
    low, high = np.nanmin(together, axis=0), np.nanmax(together, axis=0)
    long = max(float((high - low)[:2].max()), 1.0)
    margin = np.array([0.05 * long, 0.05 * long, 0.0])
    low, high = low - margin, high + margin
    missing = np.maximum((high - low)[:2].max() / 3.0 - (high - low)[:2], 0.0)
    low[:2] -= missing / 2
    high[:2] += missing / 2
    return low, high


def _happenings(runs: Sequence[LoggedRun], view: View, tracks: Sequence[VehicleTrack]) -> list[tuple[Happening, str]]:
    found = []
    for run in runs:
        own = {track.vehicle: track for track in tracks if track.run is run}
        some = happenings(run, view, {i: (track.t, track.positions) for i, track in own.items()})
        found += [(one, own[one.vehicle].colour) for one in some]
    return found


def _legend_entries(
    happened: Sequence[tuple[Happening, str]],
    runs: Sequence[LoggedRun],
    standing: Sequence[Primitive],
    *,
    linked: bool,
    flat: bool,
) -> list[Artist]:
    def mark(sign: Any, label: str, **style: Any) -> Line2D:
        look: dict[str, Any] = {"color": "0.3", "markersize": 4} | style
        return Line2D([], [], linestyle="", marker=sign, label=label, **look)

    entries: list[Artist] = []
    if any(run.scenario is not None for run in runs):
        entries.append(Line2D([], [], label="reference", **_LINE))
    if linked:
        entries.append(Line2D([], [], color="0.78", linewidth=0.8, label="links"))
    entries += [mark("o", "start", markerfacecolor="white"), mark("o", "end")]
    if flat:
        entries.append(mark((3, 0, -90.0), "direction"))
        if any(run.scenario is not None for run in runs):
            entries.append(mark("+", "desired end", color="black"))
    if any(isinstance(thing, CylinderShape) for thing in standing):
        face = {"markerfacecolor": _CYLINDER["facecolor"], "markeredgecolor": _CYLINDER["edgecolor"]}
        entries.append(mark("o", "obstacle", markersize=6, **face))
    signs = {one.what: one.mark for one, _ in happened}
    return entries + [mark(sign, what, markeredgecolor="black", markersize=5) for what, sign in signs.items()]


def _finish(figure: Figure, runs: Sequence[LoggedRun], happened: Sequence[Happening], notes: Sequence[str]) -> None:
    cut = [f"{run.label}: the log is not whole, it ends at {run.log.end:g} s" for run in runs if run.log.missing]
    write_caption(figure, [*notes, *captions(happened), *cut])


def _shapes(run: LoggedRun, view: View) -> list[tuple[Array, Array]]:
    """Edges of the graph at a few moments: pairs of positions [m, NED]."""
    shown = run.vehicles(view)
    edges = sorted({(min(a, b), max(a, b)) for a, b in run.log.links if a in shown and b in shown})
    states = {i: run.log[f"uuv/{i}/state"] for i in shown if f"uuv/{i}/state" in run.log}
    if not edges or len(edges) > _MOST_EDGES or not all(len(states.get(i, ())) for edge in edges for i in edge):
        return []
    first, last = view.window or (0.0, run.log.end)
    found = []
    for at in np.linspace(first, last, SHAPES):
        places = {}
        for i, state in states.items():
            k = min(int(np.searchsorted(state.t, at)), len(state) - 1)
            places[i] = np.array([state["x"][k], state["y"][k], state["z"][k]])
        found += [(places[a], places[b]) for a, b in edges]
    return found


def _standing(runs: Sequence[LoggedRun], view: View) -> list[Primitive]:
    scenes = [(SceneModel(run.scenario), view.window or (0.0, run.log.end)) for run in runs if run.scenario is not None]
    obstacles = dict.fromkeys(one for scene, _ in scenes for one in scene.obstacles)
    return [*obstacles, *(scene.course(*window) for scene, window in scenes)]
