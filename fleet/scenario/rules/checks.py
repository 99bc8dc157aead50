"""Rules on the checks."""

from __future__ import annotations

from fleet.quantities import show_time, vehicle_numbers
from fleet.scenario.parts import Parts
from fleet.scenario.rules.faults import fault_names
from fleet.scenario.rules.report import LINKS_SHOWN, Report, vehicles_exist, whole_multiple
from fleet.scenario.schema.checks import EVERY
from netem.selectors import parse_selector, select


def checks(parts: Parts, report: Report) -> None:
    spec = parts.spec
    for name in ("formation_error", "consensus_error", "min_separation", "connected", "tumbled"):
        check = getattr(spec.checks, name)
        if check is not None and check.vehicles:
            vehicles_exist(spec, report, ("checks", name, "vehicles"), check.vehicles)
    separation = spec.checks.min_separation
    if separation is not None and separation.vehicles and len(set(vehicle_numbers(separation.vehicles))) < 2:
        report.add(("checks", "min_separation", "vehicles"), "a distance is between two vehicles or more")


def max_age(parts: Parts, report: Report) -> None:
    spec = parts.spec
    check = spec.checks.max_age
    if check is None:
        return
    if not spec.network.ideal and check.below <= spec.network.period:
        report.add(
            ("checks", "max_age", "below"),
            f"every age grows to a round of {show_time(spec.network.period)} before the next can be heard",
            "choose more",
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
        path: tuple[str | int, ...] = ("checks", "recovery_time", *(() if one else (index,)))
        if check.fault == EVERY:
            if EVERY in known:
                message = f'"{EVERY}" means each fault, and a fault is called so'
                report.add((*path, "fault"), message, "give that fault another id")
        elif check.fault not in known:
            shown = f"known: {', '.join([*known[:LINKS_SHOWN], EVERY])}" if known else "the scenario has none"
            more = f" and {len(known) - LINKS_SHOWN} more" if len(known) > LINKS_SHOWN else ""
            report.add((*path, "fault"), f'there is no fault "{check.fault[:40]}"', shown + more)
        elif check.fault in lasting:
            message = f'"{check.fault}" lasts to the end of the run: nothing can recover from it'
            report.add((*path, "fault"), message, 'give the fault a "for"')
        if check.vehicles:
            vehicles_exist(spec, report, (*path, "vehicles"), check.vehicles)
