"""Any signal of the log over time, and what the checks of the scenario ask of it.

A signal is named as in checks and measures (`fleet.scenario.sections.signals`): `control.leads`, `command.tau_0`,
`|error.e|`. A vector, `command.tau`, has an axis for each component.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fleet.addons.pictures.axes import MOST_NAMED, Get, draw_lines, finish, time_axes
from fleet.addons.pictures.found_signal import FoundSignal, find_signal, plain_name, topic_of
from fleet.addons.pictures.runs import LoggedRun, NothingToDraw, View, check_view
from fleet.addons.pictures.signal_limits import ERRORS, PICTURES, draw_limits
from fleet.addons.pictures.thresholds import age_limits, thresholds
from fleet.errors import FleetError
from fleet.mcap.records import Array
from fleet.scenario.sections.signal_checks import checked_signals
from fleet.scenario.sections.signals import GROUPS, OF_THE_LAWS, SignalName, component, parse_name
from netem.parsing import nearest

MOST_AXES = 8  # components of a vector
MOST_UNASKED = 6  # signals that are drawn because checks name them
_FEW_VALUES = 12  # whole numbers on an axis: then lines that would hide each other are moved apart
_MOST_WORDS = 120  # characters of what a signal means


def signals_of_checks(runs: Sequence[LoggedRun]) -> list[SignalName]:
    """The signals to draw if the user names none, at most MOST_UNASKED.

    A check names some of them, and a check in Python has read others from laws and plants. Moored vehicles add the
    signals of their laws. Errors, which have a picture of their own, are left out, and so are signals that no log has.
    """
    found = [
        name
        for run in runs
        if run.scenario
        for name in checked_signals(
            run.scenario.spec.checks, (looked_at for verdict in run.verdicts for looked_at in verdict.signals)
        )
    ]
    found += [SignalName(name) for run in runs if run.moored for name in _known_signals(run, OF_THE_LAWS)]
    others = [name for name in dict.fromkeys(found) if plain_name(name).name not in ERRORS]
    return [name for name in others if any(find_signal(run, name) for run in runs)][:MOST_UNASKED]


def pictures_of_checks(runs: Sequence[LoggedRun]) -> list[str]:
    """The pictures of those errors that checks are about, and of the ages."""
    specs = [run.scenario.spec for run in runs if run.scenario is not None]
    named = {
        plain_name(name).name
        for spec in specs
        for check in spec.checks.signal or ()
        if (name := parse_name(check.topic)) is not None
    }
    errors = [PICTURES[kind] for signal, kind in ERRORS.items() if signal in named or thresholds(runs, kind)]
    return [*errors, *(["ages"] if age_limits(runs) else [])]


def require_signal(runs: Sequence[LoggedRun], name: SignalName) -> None:
    """Raises FleetError: no log has this signal, or this vehicle."""
    if name.vehicle is not None:
        check_view(runs, View((name.vehicle,)))
    if any(find_signal(run, name) for run in runs):
        return
    known = [other for run in runs for other in _known_signals(run)]
    group = [other for other in known if other.startswith(f"{name.group}.")]
    hint = nearest(name.name, list(dict.fromkeys(known)))
    if not hint:
        some = group or known
        hint = f"there are {', '.join(dict.fromkeys(some))}" if some else "the log has no signals"
    raise FleetError(f"there is no signal {name.name}; {hint}")


def picture(name: SignalName) -> Callable[[Sequence[LoggedRun], View], Figure]:
    def make(runs: Sequence[LoggedRun], view: View) -> Figure:
        if name.vehicle is None:
            return draw(runs, view, name)
        return draw(runs, replace(view, vehicles=(name.vehicle,)), name._replace(vehicle=None))

    return make


def file_name(name: SignalName) -> str:
    own = name.name if name.vehicle is None else f"uuv-{name.vehicle}-{name.name}"
    return f"norm-{own}" if name.absolute else own


def title(runs: Sequence[LoggedRun], name: SignalName) -> str:
    found = next((one for run in runs if (one := find_signal(run, name)) is not None), None)
    return f"{name}: {found.meaning}" if found is not None and found.meaning else str(name)


def draw(runs: Sequence[LoggedRun], view: View, name: SignalName) -> Figure:
    """A line per vehicle, whole numbers as steps; checks of the signal, and where it failed them. Raises NothingToDraw
    if no vehicle reports it.
    """
    found = next((one for run in runs if (one := find_signal(run, name)) is not None), None)
    if found is None:
        raise NothingToDraw(f"no vehicle reports {name.name}")
    components, notes = _components(runs, view, name, found)
    getters = [_getter(name, found, k) for k in components]
    figure, axes = time_axes(len(components), runs, view, 2.6 if len(components) == 1 else None)
    each = (get(run, i) for get in getters for run in runs for i in run.vehicles(view))
    samples = [series[1] for series in each if series is not None]
    whole = _whole(samples)
    shift = _shift(runs, view, samples) if whole else None
    shown = getters if shift is None else [_shift_time(get, shift) for get in getters]
    log = bool(view.log_scale) and not whole
    style: dict[str, Any] = {"drawstyle": "steps-post"} if whole else {}
    notes += draw_lines(figure, list(zip(axes, shown, strict=True)), runs, view, log=log, exact=whole, **style)
    for k, ax in zip(components, axes, strict=True):
        own = name if k is None or found.width == 1 else SignalName(component(found.name, k))
        ax.set_ylabel(f"{own} [{found.unit_of(k)}]")
        if log:
            ax.set_yscale("log", nonpositive="mask")
        elif whole:
            ax.yaxis.set_major_locator(MaxNLocator(6, integer=True))
        notes += draw_limits(ax, runs, view, own, shift)
    if shift is not None:
        notes.append("lines are offset for clarity")
    if found.meaning:
        notes = [shorten(f"{name.name.partition('.')[2]}: {found.meaning}", _MOST_WORDS), *notes]
    finish(figure, axes, runs, notes)
    return figure


def _known_signals(run: LoggedRun, groups: Sequence[str] = GROUPS) -> list[str]:
    return [
        f"{group}.{field}"
        for group in groups
        for i in run.log.vehicles[:1]
        if (topic := topic_of(run, i, group)) is not None
        for field in topic.fields
    ]


def _components(
    runs: Sequence[LoggedRun], view: View, name: SignalName, found: FoundSignal
) -> tuple[list[int | None], list[str]]:
    """Which components have an axis, and words on the others."""
    if name.absolute:
        return [None], []
    if found.component is not None or found.width == 1:
        return [found.component or 0], []
    still = []
    for k in range(found.width):
        each = [one[1] for run in runs for i in run.vehicles(view) if (one := _getter(name, found, k)(run, i))]
        values = np.concatenate(each) if each else np.empty(0)
        good = values[np.isfinite(values)]
        if not len(good) or (good == good[0]).all():
            still.append(k)
    moving = [k for k in range(found.width) if k not in still] or [0]
    words = []
    if len(still) and moving != [0]:
        words = [f"{len(still)} of {found.width} components never change and are left out"]
    if len(moving) > MOST_AXES:
        words.append(
            f"the first {MOST_AXES} of {len(moving)} components; others: {component(name.name, moving[MOST_AXES])}, ..."
        )
    return list(moving[:MOST_AXES]), words


def _getter(name: SignalName, found: FoundSignal, k: int | None) -> Get:
    group = name.group

    def get(run: LoggedRun, i: int) -> tuple[Array, Array] | None:
        series = run.series(i, group, found.field)
        if series is None or series[1].dtype == object or (k is not None and series[1].shape[1] <= k):
            return None
        t, values = series
        if name.absolute:
            some = values if found.component is None else values[:, [found.component]]
            return t, np.linalg.norm(some, axis=1)
        return t, values[:, k or 0]

    return get


def _whole(samples: Sequence[Array]) -> bool:
    good = [values[np.isfinite(values)] for values in samples]
    return any(map(len, good)) and all((values == np.rint(values)).all() for values in good)


def _shift(runs: Sequence[LoggedRun], view: View, samples: Sequence[Array]) -> dict[int, float] | None:
    """How far the line of each vehicle is moved, so that equal values are seen; None: not at all."""
    (run, *others) = runs
    vehicles = run.vehicles(view)
    values = np.concatenate([one[np.isfinite(one)] for one in samples])
    if others or not 2 <= len(vehicles) <= MOST_NAMED or not 0.0 < np.ptp(values) <= _FEW_VALUES:
        return None
    step = 0.012 * max(float(np.ptp(values)), 3.0)
    return {i: (k - (len(vehicles) - 1) / 2) * step for k, i in enumerate(vehicles)}


def _shift_time(get: Get, shift: dict[int, float]) -> Get:
    def moved(run: LoggedRun, i: int) -> tuple[Array, Array] | None:
        series = get(run, i)
        return None if series is None else (series[0], series[1] + shift[i])

    return moved
