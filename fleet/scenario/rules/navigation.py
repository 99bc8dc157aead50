"""Rules on the navigation of the vehicles, and on its faults."""

from __future__ import annotations

from typing import Any

from fleet.quantities import show_time
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report
from fleet.scenario.schema.navigation import FixSection, NavigationSection
from fleet.scenario.schema.spec import sections
from fleet.scenario.sections.data_files import DataFileError
from fleet.scenario.sections.navigation import DEFAULTS, KINDS, NUMBERS, grade_of, grade_problems
from fleet.scenario.sections.navigation_trace import load_trace
from fleet.scenario.sections.per_vehicle import Control
from world.navigation.config import DeadReckoning, Navigation, NavigationTrace

MOST_UNDER_WAY = 20  # fixes: the filter keeps a past position for each
_NOT_OF = {"gps": ("at", "noise_per_distance", "reach"), "usbl": ("depth",), "lbl": ("depth",)}


def navigation(parts: Parts, report: Report) -> None:
    """Every file is there, every number is possible, and fixes have what their kind needs."""
    for parent, section in sections(parts.spec, "navigation"):
        if section is not None and not section.ideal:
            _section(parts, report, (*parent, "navigation"), section)


def _section(parts: Parts, report: Report, path: tuple[str, ...], section: NavigationSection) -> None:
    if section.trace is not None:
        for key in sorted(section.model_fields_set - {"trace"}):
            hint = "the error is that of the trace"
            report.add((*path, key), "has no effect beside trace", hint, key=True)
        _files(parts, report, (*path, "trace"), section)
        return
    own = {key: value for key in NUMBERS if (value := getattr(section, key)) is not None}
    for problem in grade_problems(own):
        report.add((*path, problem.partition(" ")[0]), problem)
    at = (*path, "grade") if report.has((*path, "grade")) else path
    _files(parts, report, at, section)
    for kind in KINDS:
        fixes = getattr(section, kind)
        if fixes is not None:
            _fixes(parts, report, (*path, kind), kind, fixes)


def _files(parts: Parts, report: Report, path: tuple[str, ...], section: NavigationSection) -> None:
    try:
        grade_of(section, parts.folder) if section.trace is None else load_trace(section.trace, parts.folder)
    except DataFileError as error:
        for problem in error.problems:
            report.add(path, problem)


def _fixes(parts: Parts, report: Report, path: tuple[str, ...], kind: Any, section: FixSection) -> None:
    for key in _NOT_OF[kind]:
        if getattr(section, key) is not None:
            report.add((*path, key), f"has no effect on {kind}", key=True)
    if kind != "gps" and section.at is None:
        report.add_missing(path, "at", ": where the beacon is")
    period = DEFAULTS[kind]["period"] if section.period is None else section.period
    delay = DEFAULTS[kind]["delay"] if section.delay is None else section.delay
    if period < parts.spec.tick:
        text = f"{show_time(period)} is shorter than a tick of {show_time(parts.spec.tick)}"
        report.add((*path, "period"), text)
    elif delay > MOST_UNDER_WAY * period:
        text = f"{show_time(delay)} is more than {MOST_UNDER_WAY} periods of {show_time(period)}"
        report.add((*path, "delay"), text, "give a longer period")


def localization(parts: Parts, report: Report) -> None:
    """Localisation has ranges, messages that say how sure their sender is, and a covariance of its own."""
    network = parts.spec.network
    for parent, section in sections(parts.spec, "agent"):
        if section is None or section.localization is None:
            continue
        path = (*parent, "agent", "localization")
        if network.acoustic is None or network.acoustic.ranging is None:
            hint = "network.acoustic.ranging: one-way"
            report.add(path, "has no effect: modems measure no ranges", hint, key=True)
        if network.payload != "located":
            hint = "network.payload: located"
            report.add(path, "has no effect: messages do not say how sure their sender is", hint, key=True)
    if report.mistaken("navigation", "per_vehicle", "agent", "vehicle", "guidance", "tracking"):
        return  # what each vehicle has is not known
    for i, control in enumerate(_controls(parts), start=1):
        if control.localization is not None and isinstance(control.navigation, NavigationTrace):
            text = f"vehicle {i} has localisation, but its navigation replays a trace, which has no covariance"
            report.add(("navigation",) if report.has(("navigation",)) else ("per_vehicle",), text, "give it a grade")


def faults(parts: Parts, report: Report) -> None:
    """A fault of an instrument concerns a vehicle that has it."""
    if report.mistaken("navigation", "per_vehicle", "faults"):
        return
    vehicles, controls = range(1, parts.spec.vehicles + 1), _controls(parts)
    for index, fault in enumerate(parts.spec.faults):
        kind = fault.kind
        what = kind.needs
        if what not in ("dead reckoning", "fixes") or not controls:
            continue
        some = kind.vehicles(fault.values) or vehicles
        if not any(_has(what, controls[i - 1].navigation) for i in some):
            example = "{usbl: {at: 0 0 0 m}}" if what == "fixes" else "tactical"
            hint = f"give them one, as in navigation: {example}"
            report.add(
                ("faults", index, kind.name), f"has no effect: none of these vehicles has {what}", hint, key=True
            )


def _controls(parts: Parts) -> tuple[Control, ...]:
    """The laws of each vehicle; empty if a file cannot be read, which another rule reports."""
    try:
        return parts.controls
    except DataFileError:
        return ()


def _has(what: str, navigation: Navigation | None) -> bool:
    if not isinstance(navigation, DeadReckoning):
        return False
    return what != "fixes" or bool(navigation.fixes)
