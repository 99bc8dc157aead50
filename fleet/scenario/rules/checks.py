"""Rules on the checks, and on the triggers, which look at signals as they do."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from pydantic import ValidationError

from agents.controllers import BUILT_IN, laws, layout
from fleet.errors import FleetError
from fleet.quantities import describe_value, show_time, vehicle_numbers
from fleet.scenario.parts import Parts
from fleet.scenario.rules.faults import fault_names, report_fault
from fleet.scenario.rules.plugins import plugin
from fleet.scenario.rules.report import LINKS_SHOWN, Report, vehicles_exist, whole_multiple
from fleet.scenario.schema.checks import CHECK_NAME, EVERY, OF_THE_SCHEMA
from fleet.scenario.schema.faults import ACTIONS
from fleet.scenario.sections.node_signals import node_signals
from fleet.scenario.sections.python_checks import load_check, parameters_of
from fleet.scenario.sections.signal_checks import SignalCheckError, ask, is_of_plugin
from fleet.scenario.sections.signals import BeliefKind, SignalPlace, VehicleSignals
from fleet.scenario.sections.triggers import ask_moment, fault_of, trigger_name, wait_ns
from netem.link_selector import parse_selector, select
from netem.parsing import nearest
from world.errors import PluginError

Path = tuple[str | int, ...]  # path of a key


def checks(parts: Parts, report: Report) -> None:
    spec = parts.spec
    for name in ("formation_error", "consensus_error", "min_separation", "connected", "tumbled"):
        check = getattr(spec.checks, name)
        if check is not None and check.vehicles:
            vehicles_exist(spec, report, ("checks", name, "vehicles"), check.vehicles)
    separation = spec.checks.min_separation
    if separation is not None and separation.vehicles and len(set(vehicle_numbers(separation.vehicles))) < 2:
        report.add(("checks", "min_separation", "vehicles"), "expected two vehicles or more, got one")


def max_age(parts: Parts, report: Report) -> None:
    spec = parts.spec
    check = spec.checks.max_age
    if check is None:
        return
    if not spec.network.ideal and check.below <= spec.network.period:
        report.add(
            ("checks", "max_age", "below"),
            f"{show_time(check.below)} is not above a round of {show_time(spec.network.period)}",
            "choose several rounds: without any loss an age already grows to one round",
        )
    if check.links != "*" and not select(parse_selector(check.links), parts.links):
        report.add(("checks", "max_age", "links"), f"the graph has no link {check.links}")


def connected(parts: Parts, report: Report) -> None:
    spec = parts.spec
    check = spec.checks.connected
    if check is None:
        return
    path = ("checks", "connected", "window")
    whole_multiple(report, path, check.window, spec.tick)
    if not spec.network.ideal and check.window < spec.network.period:
        message = f"is shorter than a round of {show_time(spec.network.period)}: nothing is sent in some windows"
        report.add(path, message, "choose several rounds")


def recovery_time(parts: Parts, report: Report) -> None:
    spec = parts.spec
    checks = spec.checks.recovery_time
    if not checks or report.mistaken("faults", "nemesis"):
        return
    known, lasting = fault_names(parts)
    one = bool(report.keys("checks", "recovery_time"))  # given without the list
    for index, check in enumerate(checks):
        path: Path = ("checks", "recovery_time", *(() if one else (index,)))
        _ends(report, (*path, "fault"), check.fault, known, lasting)
        if check.vehicles:
            vehicles_exist(spec, report, (*path, "vehicles"), check.vehicles)


def _ends(report: Report, path: Path, fault: str, known: list[str], lasting: set[str]) -> None:
    """Report a fault that there is not, or that does not end."""
    if fault == EVERY:
        if EVERY in known:
            message = f'"{EVERY}" means each fault, and a fault is called so'
            report.add(path, message, "give that fault another id")
    elif fault not in known:
        shown = f"known: {', '.join([*known[:LINKS_SHOWN], EVERY])}" if known else "the scenario has none"
        more = f" and {len(known) - LINKS_SHOWN} more" if len(known) > LINKS_SHOWN else ""
        report.add(path, f'there is no fault "{fault[:40]}"', shown + more)
    elif fault in lasting:
        message = f'"{fault}" lasts to the end of the run: nothing can recover from it'
        report.add(path, message, 'give the fault a "for"')


def signal(parts: Parts, report: Report) -> None:
    """Each check on a signal makes sense, and its signal is one of these vehicles."""
    spec = parts.spec
    checks = spec.checks.signal
    if not checks:
        return
    one = bool(report.keys("checks", "signal"))  # given without the list
    vehicles = _signals(parts, report)
    for index, check in enumerate(checks):
        path: Path = ("checks", "signal", *(() if one else (index,)))
        if vehicles is not None or not is_of_plugin(check.topic):
            try:
                ask(check, vehicles or _known_to_all(parts))
            except SignalCheckError as error:
                told = [*(spec.signals or ())]
                known = nearest(check.topic, told) or f"the signals are {', '.join(told) or 'none'}"
                report.add(
                    (*path, error.key), error.problem, known if spec.nodes and error.key == "topic" else error.hint
                )
        if check.fault is not None and not report.mistaken("faults", "nemesis"):
            _ends(report, (*path, "fault"), check.fault, *fault_names(parts))


def triggers(parts: Parts, report: Report) -> None:
    """Each trigger waits for a moment of some vehicle, and begins a fault."""
    spec = parts.spec
    if not spec.triggers:
        return
    if spec.network.ideal:
        report.add(("triggers",), "need a network, and this one is ideal", "give the network a period")
        return
    taken = {fault.id or f"f{n}" for n, fault in enumerate(spec.faults, start=1)}
    vehicles = _signals(parts, report)
    for index, trigger in enumerate(spec.triggers):
        path: Path = ("triggers", index)
        name = trigger_name(trigger, index + 1)
        if name in taken:
            report.add((*path, "id"), f'another fault has the id "{name}" already', "give every fault its own id")
        taken.add(name)
        for key, time in (("wait", trigger.wait), ("for", trigger.for_)):
            if time is not None:
                whole_multiple(report, (*path, key), time, spec.tick)
        if wait_ns(trigger, spec) < spec.network.period:
            report.add((*path, "wait"), f"is shorter than a round of {show_time(spec.network.period)}")
        if vehicles is not None:
            try:
                ask_moment(trigger.when, vehicles)
            except SignalCheckError as error:
                report.add((*path, "when", error.key), error.problem, error.hint)
        if unknown := next((key for key in trigger.fault if key.partition(" ")[0] not in ACTIONS), ""):
            hint = nearest(unknown, ACTIONS) or f"one of {', '.join(ACTIONS)}; wait, for and id stand beside fault"
            report.add((*path, "fault", unknown), "is no kind of fault", hint, key=True)
            continue
        try:
            fault = fault_of(trigger, name, 0, 1, spec, [2])
        except ValidationError as error:
            wrong = error.errors()[0]
            report.add((*path, "fault", *wrong["loc"]), str(wrong.get("ctx", {}).get("message", wrong["msg"])))
        else:
            if fault is not None:  # with one vehicle there are no others
                report_fault(report, (*path, "fault"), fault, spec, parts.links)


def _signals(parts: Parts, report: Report) -> dict[int, Mapping[str, SignalPlace]] | None:
    """The signals of every vehicle; None: they are not known, because a law is wrong or must not be imported."""
    if parts.spec.nodes is not None:
        return {i: node_signals(parts.spec, i).places() for i in range(1, parts.spec.vehicles + 1)}
    try:
        controls = parts.controls
        running = ((kind, law) for control in controls for kind, law in laws(control).items())
        others = any(law.name not in BUILT_IN[kind] for kind, law in running)
        if others and (not report.policy.imports or report.mistaken("agent", "controller", "guidance", "tracking")):
            return None
        return {
            i: VehicleSignals(
                layout(control), control.plant_signals(), i in parts.clocks, BeliefKind.of(control.navigation)
            ).places()
            for i, control in enumerate(controls, start=1)
        }
    except (FleetError, PluginError):  # reported where it is about
        return None


def _known_to_all(parts: Parts) -> dict[int, Mapping[str, SignalPlace]]:
    """The signals that every vehicle has, whatever its laws are."""
    everyone = range(1, parts.spec.vehicles + 1)
    return {i: VehicleSignals(has_clock=i in parts.clocks, belief=BeliefKind.FILTER).places() for i in everyone}


def python(parts: Parts, report: Report) -> None:
    """Each check in Python can be imported, and made with its parameters."""
    for name, each in (parts.spec.checks.python or {}).items():
        if report.policy.checks:
            plugin(parts, report, ("checks", name), "check", name, (), partial(_load_all, name, each))


def _load_all(name: str, each: Iterable[Mapping[str, Any]]) -> None:
    for one in each:
        load_check(name, parameters_of(one))


def names(parts: Parts, report: Report) -> None:
    """No two verdicts have the same name."""
    seen: set[str] = set()
    for check in parts.spec.checks.own():
        name = check.name
        path: Path = (
            ("checks", check.key, "name")
            if report.keys("checks", check.key)
            else ("checks", check.key, check.place, "name")
        )
        if check.given and not re.fullmatch(CHECK_NAME, name):
            report.add(path, f"expected letters, digits, _, . and -, got {describe_value(name)}", "a letter first")
        elif check.given and (name in seen or name in OF_THE_SCHEMA):
            report.add(path, f'another check is called "{name}"', "every verdict has a name of its own")
        seen.add(name)
