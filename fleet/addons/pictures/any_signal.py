"""Any signal of the log over time, and what the checks of the scenario ask of it.

A signal is named as in checks and measures (`fleet.scenario.sections.signals`): `control.leads`, `command.tau_0`,
`|error.e|`. A vector, `command.tau`, has an axis for each component.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isfinite
from textwrap import wrap
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fleet.addons.pictures.axes import COLOUR, MOST_NAMED, Get, draw_lines, finish, over_time
from fleet.addons.pictures.runs import NothingToDraw, Run, View, check_view
from fleet.addons.pictures.thresholds import Threshold, draw_thresholds
from fleet.errors import FleetError
from fleet.logs.records import Array
from fleet.logs.topic import Topic
from fleet.scenario.schema.checks import SignalCheck
from fleet.scenario.sections.signal_checks import AskedOfSignal, SignalCheckError, ask, checked_signals
from fleet.scenario.sections.signals import GROUPS, OF_THE_LAWS, SignalName, SignalPlace, component, parse_name
from netem.parsing import nearest

MOST_AXES = 8  # components of a vector
MOST_UNASKED = 6  # signals that are drawn because checks name them
_FEW_VALUES = 12  # whole numbers on an axis: then lines that would hide each other are moved apart
_LINE = 52  # characters that fit below a picture


class _Found(NamedTuple):
    name: str  # as the log has it, or a component of that
    field: str
    component: int | None  # None: the whole
    unit: str
    meaning: str
    width: int


def signals_of_checks(runs: Sequence[Run]) -> list[SignalName]:
    """The signals to draw if the user names none, at most MOST_UNASKED.

    A check names some of them, and a check in Python has read others from laws and plants. Moored vehicles add the
    signals of their laws. Errors that have a picture of their own are left out, and so are signals that no log has.
    """
    found = [
        name
        for run in runs
        if run.scenario
        for name in checked_signals(
            run.scenario.spec.checks, (looked_at for verdict in run.verdicts for looked_at in verdict.signals)
        )
    ]
    found += [SignalName(name) for run in runs if run.moored for name in _known(run, OF_THE_LAWS)]
    return [name for name in dict.fromkeys(found) if any(_find(run, name) for run in runs)][:MOST_UNASKED]


def need(runs: Sequence[Run], name: SignalName) -> None:
    """Raises FleetError: no log has this signal, or this vehicle."""
    if name.vehicle is not None:
        check_view(runs, View((name.vehicle,)))
    if any(_find(run, name) for run in runs):
        return
    known = [other for run in runs for other in _known(run)]
    group = [other for other in known if other.startswith(f"{name.group}.")]
    hint = nearest(name.name, list(dict.fromkeys(known)))
    if not hint:
        some = group or known
        hint = f"there are {', '.join(dict.fromkeys(some))}" if some else "the log has no signals"
    raise FleetError(f"there is no signal {name.name}; {hint}")


def picture(name: SignalName) -> Callable[[Sequence[Run], View], Figure]:
    def make(runs: Sequence[Run], view: View) -> Figure:
        if name.vehicle is None:
            return draw(runs, view, name)
        return draw(runs, replace(view, vehicles=(name.vehicle,)), name._replace(vehicle=None))

    return make


def file_name(name: SignalName) -> str:
    own = name.name if name.vehicle is None else f"uuv-{name.vehicle}-{name.name}"
    return f"norm-{own}" if name.absolute else own


def title(runs: Sequence[Run], name: SignalName) -> str:
    found = next((one for run in runs if (one := _find(run, name)) is not None), None)
    return f"{name}: {found.meaning}" if found is not None and found.meaning else str(name)


def draw(runs: Sequence[Run], view: View, name: SignalName) -> Figure:
    """A line per vehicle, whole numbers as steps; checks of the signal, and where it failed them. Raises NothingToDraw
    if no vehicle reports it.
    """
    found = next((one for run in runs if (one := _find(run, name)) is not None), None)
    if found is None:
        raise NothingToDraw(f"no vehicle reports {name.name}")
    components, notes = _components(runs, view, name, found)
    getters = [_getter(name, found, k) for k in components]
    figure, axes = over_time(len(components), runs, view, 2.6 if len(components) == 1 else None)
    each = (get(run, i) for get in getters for run in runs for i in run.vehicles(view))
    samples = [series[1] for series in each if series is not None]
    whole = _whole(samples)
    shift = _shift(runs, view, samples) if whole else None
    shown = getters if shift is None else [_moved(get, shift) for get in getters]
    log = bool(view.log_scale) and not whole
    style = {"drawstyle": "steps-post"} if whole else {}
    notes += draw_lines(figure, list(zip(axes, shown, strict=True)), runs, view, log=log, exact=whole, **style)
    for k, ax in zip(components, axes, strict=True):
        own = name if k is None or found.width == 1 else SignalName(component(found.name, k))
        ax.set_ylabel(f"{own} [{_unit(found, k)}]")
        if log:
            ax.set_yscale("log", nonpositive="mask")
        elif whole:
            ax.yaxis.set_major_locator(MaxNLocator(6, integer=True))
        _asked(ax, runs, own)
        _failed(ax, runs, own, shift)
    if shift is not None:
        notes.append("lines are offset for clarity")
    if found.meaning:
        notes = [*wrap(f"{name.name.partition('.')[2]}: {found.meaning}", _LINE)[:2], *notes]
    finish(figure, axes, runs, notes)
    return figure


def _topic(run: Run, i: int, group: str) -> Topic | None:
    topic = f"uuv/{i}/{group}"
    return run.log[topic] if topic in run.log and len(run.log[topic]) else None


def _find(run: Run, name: SignalName) -> _Found | None:
    """The signal in the topic of the first vehicle that has it; of a component, the vector that it is one of."""
    group, _, field = name.name.partition(".")
    if group not in GROUPS:
        return None
    for i in run.log.vehicles:
        topic = _topic(run, i, group)
        if topic is None or topic.too_many:
            continue
        part = re.fullmatch(r"(\w+)_(\d{1,4})", field)
        if field in topic:
            own, k = field, None
        elif part is not None and part[1] in topic and int(part[2]) < _width(topic, part[1]):
            own, k = part[1], int(part[2])
        else:
            continue
        unit, meaning = topic.declaration(own)
        return _Found(f"{group}.{own}", own, k, unit or "1", meaning, _width(topic, own))
    return None


def _known(run: Run, groups: Sequence[str] = GROUPS) -> list[str]:
    return [
        f"{group}.{field}"
        for group in groups
        for i in run.log.vehicles[:1]
        if (topic := _topic(run, i, group)) is not None
        for field in topic.fields
    ]


def _width(topic: Topic, field: str) -> int:
    values = topic[field]
    return 1 if values.ndim == 1 else values.shape[1]


def _components(runs: Sequence[Run], view: View, name: SignalName, found: _Found) -> tuple[list[int | None], list[str]]:
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


def _getter(name: SignalName, found: _Found, k: int | None) -> Get:
    group = name.group

    def get(run: Run, i: int) -> tuple[Array, Array] | None:
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


def _shift(runs: Sequence[Run], view: View, samples: Sequence[Array]) -> dict[int, float] | None:
    """How far the line of each vehicle is moved, so that equal values are seen; None: not at all."""
    (run, *others) = runs
    vehicles = run.vehicles(view)
    values = np.concatenate([one[np.isfinite(one)] for one in samples])
    if others or not 2 <= len(vehicles) <= MOST_NAMED or not 0.0 < np.ptp(values) <= _FEW_VALUES:
        return None
    step = 0.012 * max(float(np.ptp(values)), 3.0)
    return {i: (k - (len(vehicles) - 1) / 2) * step for k, i in enumerate(vehicles)}


def _moved(get: Get, shift: dict[int, float]) -> Get:
    def moved(run: Run, i: int) -> tuple[Array, Array] | None:
        series = get(run, i)
        return None if series is None else (series[0], series[1] + shift[i])

    return moved


def _unit(found: _Found, k: int | None) -> str:
    units = found.unit.split(", ")
    return units[k] if k is not None and len(units) == found.width else found.unit


def _asked(ax: Axes, runs: Sequence[Run], name: SignalName) -> None:
    lines = []
    for run in runs:
        for check in (run.scenario.spec.checks.signal or ()) if run.scenario is not None else ():
            asked = _as_asked(run, check, name)
            if asked is None or asked.condition.over != "each" or asked.within_ns is not None:
                continue
            for value in sorted({asked.condition.low, asked.condition.high}):
                if isfinite(value):
                    words = asked.words.removeprefix(f"{name} ")
                    lines.append(Threshold(value, asked.after_ns / 1e9, run.log.end, "", words))
    draw_thresholds(ax, list(dict.fromkeys(lines)))


def _as_asked(run: Run, check: SignalCheck, name: SignalName) -> AskedOfSignal | None:
    if parse_name(check.topic) != name:
        return None
    each: dict[int, dict[str, SignalPlace]] = {i: {} for i in run.log.vehicles}
    if (found := _find(run, name)) is not None:
        place = SignalPlace(slice(0, 1), _unit(found, found.component))
        for i in each:
            topic = _topic(run, i, name.group)
            if topic is not None and found.field in topic:
                each[i] = {name.name: place}
    try:
        return ask(check, each)
    except SignalCheckError:
        return None


def _failed(ax: Axes, runs: Sequence[Run], name: SignalName, shift: dict[int, float] | None) -> None:
    """A cross on the value of each vehicle that failed a check of the signal, at the time of the failure."""
    for run in runs:
        for moment in (verdict.moment for verdict in run.verdicts if verdict.moment is not None):
            for key, value in moment.values.items():
                vehicle = re.fullmatch(r"uuv/(\d{1,6})/(.+)", key)
                if vehicle is None or vehicle[2] != str(name) or value is None:
                    continue
                i = int(vehicle[1])
                ax.plot(
                    moment.at_s, value + (shift or {}).get(i, 0.0), "x", color=COLOUR, markersize=5,
                    markeredgewidth=1.2, zorder=6, gid=f"failed-{i}",
                )  # fmt: skip
