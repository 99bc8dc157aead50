"""Pictures of the vehicles over time: errors with the limits of checks, inputs with their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from fleet.addons.pictures.axes import (
    MOST_NAMED,
    SMALLEST,
    Get,
    clip_to_window,
    draw_lines,
    finish,
    time_axes,
    time_span,
)
from fleet.addons.pictures.axes import bounds as draw_bounds
from fleet.addons.pictures.beliefs import beliefs
from fleet.addons.pictures.runs import LoggedRun, View, with_gaps
from fleet.addons.pictures.signal_limits import draw_limits
from fleet.addons.pictures.style import (
    HEAVY,
    panels,
    plain_decades,
)
from fleet.mcap.records import Array
from fleet.scenario.sections.per_vehicle import Control
from fleet.scenario.sections.signals import SignalName

FORCES = (("surge force", "N"), ("pitch moment", "N m"), ("yaw moment", "N m"))
HEAVY_SUFFIX = "-saturated"
_ROW_IN = 0.8
_AT_LIMIT = 1.0 - 1e-6


def component(group: str, name: str, k: int = 0) -> Get:
    def get(run: LoggedRun, i: int) -> tuple[Array, Array] | None:
        found = run.series(i, group, name)
        if found is None or found[1].shape[1] <= k:
            return None
        return found[0], found[1][:, k]

    return get


def consensus(runs: Sequence[LoggedRun], view: View) -> Figure:
    """|e_i| of each vehicle."""
    return _norm(runs, view, "e_norm", "consensus error $|e|$ [m]")


def formation(runs: Sequence[LoggedRun], view: View) -> Figure:
    """Distance of each vehicle from its desired position; below it what vehicles that navigate believe of it."""
    believed = any(beliefs(run.log, i) for run in runs for i in run.vehicles(view))
    return _norm(runs, view, "formation_norm", "formation error [m]", believed=believed)


def _believed_formation(run: LoggedRun, i: int) -> tuple[Array, Array] | None:
    known = beliefs(run.log, i)
    if known is None:
        return None
    t, values = with_gaps(known.t, known.formation_norm[:, np.newaxis], known.step_s)
    return t, values[:, 0]


def _norm(runs: Sequence[LoggedRun], view: View, name: str, label: str, *, believed: bool = False) -> Figure:
    figure, axes = time_axes(2, runs, view) if believed else time_axes(1, runs, view, 2.4)
    log = view.log_scale is not False
    panel = list(zip(axes, (component("error", name), _believed_formation), strict=False))
    notes = draw_lines(figure, panel, runs, view, log=log)
    for ax, text in zip(axes, (label, "as they believe it [m]"), strict=False):
        ax.set_ylabel(text)
        if log:
            _logarithmic(ax)
    notes += draw_limits(axes[0], runs, view, SignalName(f"error.{name}"))
    for ax in axes:
        if log:
            _logarithmic(ax)  # limits may lie beyond the lines
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


def inputs(runs: Sequence[LoggedRun], view: View) -> Figure:
    """Force and moments as applied; heavy where the commanded ones are at their limit. A few vehicles have a row each,
    since their lines would hide each other.
    """
    vehicles = sorted({i for run in runs for i in run.vehicles(view)})
    if not 2 <= len(vehicles) <= MOST_NAMED:
        figure, axes = time_axes(len(FORCES), runs, view)
        places: list[_Place] = [(ax, k, vehicles) for k, ax in enumerate(axes)]
        columns = 1
    else:
        columns = len(FORCES)
        figure, axes = panels(len(vehicles), columns, height=_ROW_IN * len(vehicles) + 0.8)
        axes[0].set_xlim(time_span(runs, view))
        places = [(ax, n % columns, [vehicles[n // columns]]) for n, ax in enumerate(axes)]
    panel = [(ax, _getter(some, component("command", "applied", k))) for ax, k, some in places]
    # An input is held until the next one.
    notes = draw_lines(figure, panel, runs, view, apart=columns > 1, drawstyle="steps-post")
    saturated = False
    for ax, k, some in places:
        most: dict[str, float] = {}
        for run in runs:
            for i, control in _controls(run, replace(view, vehicles=tuple(some))):
                most[f"{run.slug}-vehicle-{i}"] = control.tau_max[k]
                saturated |= _heavy(ax, run, view, i, k, control.tau_max[k], HEAVY if columns > 1 else 2.0 * HEAVY)
        name, unit = FORCES[k]
        if far := draw_bounds(ax, [(-value, value) for value in most.values()], f"limits of the {name}", unit):
            notes.append(far)
        elif most:
            _keep_inside(ax, most)
        if columns == 1:
            ax.set_ylabel(f"{name} [{unit}]")
    if columns > 1:
        _name_grid(axes, [next(run for run in runs if i in run.log.vehicles).vehicle_label(i) for i in vehicles])
    if saturated:
        many = any(len(run.vehicles(view)) > MOST_NAMED for run in runs)
        notes.append(f"heavy: {'the command of a named one' if many else 'the command'} is at a limit")
    finish(figure, axes, runs, list(dict.fromkeys(notes)), columns)
    return figure


_Place = tuple[Axes, int, Sequence[int]]  # axes, the component, and the vehicles that it shows


def _getter(vehicles: Sequence[int], get: Get) -> Get:
    return lambda run, i: get(run, i) if i in vehicles else None


def _name_grid(axes: Sequence[Axes], names: Sequence[str]) -> None:
    """A vehicle for each row and a component for each column; a column has one scale."""
    for k, (name, unit) in enumerate(FORCES):
        column = axes[k :: len(FORCES)]
        ends = [ax.get_ylim() for ax in column]
        for ax in column:
            ax.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))
        column[0].set_title(f"{name} [{unit}]")
    for ax, name in zip(axes[:: len(FORCES)], names, strict=True):
        ax.set_ylabel(name)


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


def _heavy(ax: Axes, run: LoggedRun, view: View, i: int, k: int, limit: float, width: float) -> bool:
    found, commanded = run.series(i, "command", "applied"), run.series(i, "command", "tau")
    line = next((one for one in ax.get_lines() if one.get_gid() == f"{run.slug}-vehicle-{i}"), None)
    if found is None or commanded is None or line is None or not limit > 0.0:
        return False
    t, values = clip_to_window(found[0], found[1][:, k], view.window)
    _, asked = clip_to_window(*commanded, view.window)
    at_limit = np.abs(asked[:, k]) >= _AT_LIMIT * limit
    if not at_limit.any():
        return False
    for heavy in (at_limit & (values > 0.0), at_limit & (values < 0.0)):  # no line joins the one limit with the other
        if not heavy.any():
            continue
        ax.plot(
            t, np.where(heavy, values, np.nan), color=line.get_color(), linewidth=width, alpha=0.6,
            solid_capstyle="butt", marker="|", markersize=width, drawstyle="steps-post",
            gid=f"{run.slug}-vehicle-{i}{HEAVY_SUFFIX}",
        )  # fmt: skip
    return True


def _controls(run: LoggedRun, view: View) -> list[tuple[int, Control]]:
    if run.scenario is None:
        return []
    return [(i, run.scenario.controls[i - 1]) for i in run.vehicles(view) if i <= run.scenario.vehicles]
