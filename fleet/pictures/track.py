"""Where the vehicles went: from above, east to the right and north up, and in three dimensions, depth downwards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fleet.logs.records import Array
from fleet.pictures.axes import MOST_NAMED, colours, legend_of, vehicle_bar
from fleet.pictures.runs import NothingToDraw, Run, View
from fleet.pictures.style import COLUMN_IN, STYLES

SHAPES = 5  # moments at which the formation is drawn
_MOST_EDGES = 60  # of the graph that are drawn as the formation's shape
_REFERENCE_POINTS = 400


def top(runs: Sequence[Run], view: View) -> Figure:
    """North over east, to scale."""
    tracks = _tracks(runs, view)
    everything = np.concatenate([p for track in tracks.values() for p in track.values()])[:, :2]
    north, east = np.ptp(everything, axis=0) + 1e-9
    figure = Figure(figsize=(COLUMN_IN, _height(north / east)), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    for run in runs:
        for a, b in _shapes(run, view):
            ax.plot([a[1], b[1]], [a[0], b[0]], color="0.72", linewidth=0.5, zorder=1, gid="formation")
        reference = _reference(run, view)
        if reference is not None:
            ax.plot(
                reference[:, 1], reference[:, 0], color="0.4", linewidth=0.6, linestyle=":", zorder=1, gid="reference"
            )
    for (label, i), colour, style in _styles(tracks):
        p = tracks[label][i]
        ax.plot(p[:, 1], p[:, 0], color=colour, linestyle=style, linewidth=0.9, zorder=2, gid=f"vehicle-{i}")
        ax.plot(p[0, 1], p[0, 0], "o", color=colour, markersize=3.5, markerfacecolor="white", zorder=3)
        ax.plot(p[-1, 1], p[-1, 0], "o", color=colour, markersize=3.5, zorder=3)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("east [m]")
    ax.set_ylabel("north [m]")
    _words(figure, runs)
    _legend(figure, [ax], runs, view, tracks)
    return figure


def space(runs: Sequence[Run], view: View) -> Figure:
    """East, north and depth; the three axes have scales of their own."""
    tracks = _tracks(runs, view)
    figure = Figure(figsize=(COLUMN_IN, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    ax: Any = figure.add_subplot(projection="3d")
    for run in runs:
        for a, b in _shapes(run, view):
            ax.plot([a[1], b[1]], [a[0], b[0]], [a[2], b[2]], color="0.72", linewidth=0.5, gid="formation")
        reference = _reference(run, view)
        if reference is not None:
            ax.plot(*reference[:, [1, 0, 2]].T, color="0.4", linewidth=0.6, linestyle=":", gid="reference")
    for (label, i), colour, style in _styles(tracks):
        p = tracks[label][i]
        ax.plot(p[:, 1], p[:, 0], p[:, 2], color=colour, linestyle=style, linewidth=0.9, gid=f"vehicle-{i}")
        ax.plot(p[:1, 1], p[:1, 0], p[:1, 2], "o", color=colour, markersize=3.5, markerfacecolor="white")
        ax.plot(p[-1:, 1], p[-1:, 0], p[-1:, 2], "o", color=colour, markersize=3.5)
    low, high = ax.get_zlim()
    if high - low < 0.5:  # m: otherwise a flat course looks rough
        low, high = (low + high) / 2 - 0.25, (low + high) / 2 + 0.25
    ax.set_zlim(high, low)  # down is down
    ax.set_xlabel("east [m]", labelpad=-2)
    ax.set_ylabel("north [m]", labelpad=-2)
    ax.set_zlabel("depth [m]", labelpad=1)
    ax.tick_params(pad=-2)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    ax.view_init(elev=28, azim=-60)
    ax.set_box_aspect((1, 1.2, 0.7), zoom=0.9)
    _words(figure, runs)
    _legend(figure, [ax], runs, view, tracks)
    return figure


def _tracks(runs: Sequence[Run], view: View) -> dict[str, dict[int, Array]]:
    """Run -> vehicle -> positions (samples, 3) [m, NED], in the window."""
    found: dict[str, dict[int, Array]] = {}
    for run in runs:
        for i in run.vehicles(view):
            topic = f"uuv/{i}/state"
            if topic not in run.log or not len(run.log[topic]):
                continue
            state = run.log[topic]
            positions = np.column_stack([state["x"], state["y"], state["z"]])[_inside(state.t, view)]
            if len(positions):
                found.setdefault(run.label, {})[i] = positions
    if not found:
        raise NothingToDraw("the log has no state of a vehicle in that time")
    return found


def _inside(t: Array, view: View) -> Array:
    return np.full(len(t), True) if view.window is None else (t >= view.window[0]) & (t <= view.window[1])


def _styles(tracks: dict[str, dict[int, Array]]) -> list[tuple[tuple[str, int], Any, Any]]:
    shown = sorted({i for track in tracks.values() for i in track})
    by_run = len(tracks) > 1
    palette = colours(len(tracks) if by_run else len(shown))
    found = []
    for r, (label, track) in enumerate(tracks.items()):
        for i in track:
            k = r if by_run else shown.index(i)
            found.append(((label, i), palette[k], STYLES[k] if len(palette) <= MOST_NAMED and by_run else "-"))
    return found


def _legend(figure: Figure, axes: list[Axes], runs: Sequence[Run], view: View, tracks: dict[str, Any]) -> None:
    shown = sorted({i for track in tracks.values() for i in track})
    more: list[tuple[str, Any, Any]] = []
    if any(_reference(run, view) is not None for run in runs):
        more = [("reference", "0.4", ":")]
    if len(tracks) > 1:
        palette = colours(len(tracks))
        legend_of(figure, [*((label, palette[k], STYLES[k % len(STYLES)]) for k, label in enumerate(tracks)), *more])
    elif len(shown) <= MOST_NAMED:
        legend_of(figure, [*((f"UUV {i}", colours(len(shown))[k], "-") for k, i in enumerate(shown)), *more])
    else:
        vehicle_bar(figure, axes, shown)


def _shapes(run: Run, view: View) -> list[tuple[Array, Array]]:
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


def _reference(run: Run, view: View) -> Array | None:
    """Positions of the reference (points, 3) [m, NED]."""
    if run.scenario is None:
        return None
    first, last = view.window or (0.0, run.log.end)
    return np.array([run.scenario.reference.at(t).position for t in np.linspace(first, last, _REFERENCE_POINTS)])


def _height(ratio: float) -> float:
    """Height [in] of a picture whose content is `ratio` times as high as wide."""
    return float(np.clip((COLUMN_IN - 0.6) * ratio, 1.4, 4.2)) + 0.8


def _words(figure: Figure, runs: Sequence[Run]) -> None:
    """What the marks mean, below everything."""
    cut = [f"{run.label}: the log is not whole, it ends at {run.log.end:g} s" for run in runs if run.log.missing]
    words = ["open circle: start, filled: end; grey: links of the graph", *cut]
    figure.supxlabel("\n".join(words), fontsize=7)
