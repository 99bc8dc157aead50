"""What the checks of a scenario ask of a signal, drawn as limits, and a cross where a vehicle failed one."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from math import isfinite

import numpy as np
from matplotlib.axes import Axes

from fleet.addons.pictures.axes import COLOUR
from fleet.addons.pictures.found_signal import find_signal, plain_name, topic_of
from fleet.addons.pictures.runs import LoggedRun, View
from fleet.addons.pictures.thresholds import Threshold, draw_thresholds, thresholds
from fleet.scenario.schema.checks import EVERY, SignalCheck
from fleet.scenario.sections.signal_checks import AskedOfSignal, SignalCheckError, ask
from fleet.scenario.sections.signals import SignalName, SignalPlace, parse_name

# The errors that have checks and a picture of their own.
ERRORS = {"error.e_norm": "consensus", "error.formation_norm": "formation"}
PICTURES = {"consensus": "error", "formation": "formation"}


def draw_limits(
    ax: Axes, runs: Sequence[LoggedRun], view: View, name: SignalName, shift: dict[int, float] | None = None
) -> list[str]:
    """Draw all that checks ask of a signal, and where vehicles failed it; returns words on what is no line.

    `shift`: how far the line of each vehicle is moved from its value.
    """
    own, lines, words = plain_name(name), list[Threshold](), list[str]()
    if own.name in ERRORS:
        lines += thresholds(runs, ERRORS[own.name])
    for run in runs:
        for check in (run.scenario.spec.checks.signal or ()) if run.scenario is not None else ():
            asked = _as_asked(run, check, own)
            if asked is not None and asked.condition.over != "each":
                words.append(f"check: {asked.words.removeprefix(str(asked.signal)).strip()}")
            elif asked is not None:
                lines += _lines(run, asked)
    words += draw_thresholds(ax, list(dict.fromkeys(lines)))
    _draw_failed(ax, runs, view, own, shift or {})
    return list(dict.fromkeys(words))


def _as_asked(run: LoggedRun, check: SignalCheck, name: SignalName) -> AskedOfSignal | None:
    topic = parse_name(check.topic)
    if topic is None or plain_name(topic) != name:
        return None
    each: dict[int, dict[str, SignalPlace]] = {i: {} for i in run.log.vehicles}
    if (found := find_signal(run, topic)) is not None:
        place = SignalPlace(slice(0, 1), found.unit_of(found.component))
        for i in each:
            has = topic_of(run, i, topic.group)
            if has is not None and found.field in has:
                each[i] = {topic.name: place}
    try:
        return ask(check, each)
    except SignalCheckError:
        return None


def _lines(run: LoggedRun, asked: AskedOfSignal) -> Iterator[Threshold]:
    words = asked.words.removeprefix(f"{asked.signal} ")
    for value in sorted({asked.condition.low, asked.condition.high}):
        if isfinite(value):
            for begin, end in _times(run, asked):
                yield Threshold(value, begin, end, "", words)


def _times(run: LoggedRun, asked: AskedOfSignal) -> list[tuple[float, float]]:
    """When it has to hold, or within which time it has to begin [s]."""
    after = asked.after_ns / 1e9
    if asked.within_ns is None:
        return [(after, run.log.end)]
    within = asked.within_ns / 1e9
    if asked.fault is None:
        return [(after, after + within)]
    ends = [fault.end for fault in run.log.faults if asked.fault in (EVERY, fault.id) and fault.end < run.log.end]
    return [(end, end + within) for end in ends]


def _draw_failed(ax: Axes, runs: Sequence[LoggedRun], view: View, name: SignalName, shift: dict[int, float]) -> None:
    """A cross on the value of each vehicle that failed a check of the signal, at the time of the failure."""
    first, last = ax.get_xlim()
    for run in runs:
        shown = run.vehicles(view)
        for at_s, i, value in _failures(run, name):
            if i in shown and first <= at_s <= last:
                ax.plot(
                    at_s, value + shift.get(i, 0.0), "x", color=COLOUR, markersize=5, markeredgewidth=1.2, zorder=6,
                    gid=f"failed-{i}",
                )  # fmt: skip


def _failures(run: LoggedRun, name: SignalName) -> Iterator[tuple[float, int, float]]:
    """Time [s], vehicle and value of each failure."""
    for verdict in run.verdicts:
        moment = verdict.moment
        if moment is None:
            continue
        for key, value in moment.values.items():
            of = re.fullmatch(r"uuv/(\d{1,6})/(.+)", key)
            signal = None if of is None else parse_name(of[2])
            if of is not None and signal is not None and value is not None and plain_name(signal) == name:
                yield moment.at_s, int(of[1]), value
        # A check of an error names no signal: it is the error itself.
        if verdict.check == f"{ERRORS.get(name.name)}_error":
            for i in moment.vehicles:
                series = run.series(i, name.group, name.name.partition(".")[2])
                if series is not None:
                    yield moment.at_s, i, float(np.interp(moment.at_s, series[0], series[1][:, 0]))
