"""Verdicts: the checks that a scenario declares, judged on what the run recorded."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from fleet.fields import vehicle_numbers
from fleet.journal import Journal
from fleet.scenario import Scenario
from fleet.schema import AtMost, Below, Connected, MaxAge, MinSeparation, Recovery
from fleet.stability import names
from netem.grammar import parse_selector, select


@dataclass(frozen=True, slots=True)
class Verdict:
    """One check: what was asked, what was found."""

    check: str
    passed: bool
    asked: str
    found: str

    def to_values(self) -> dict[str, Any]:
        return asdict(self)


def judge(scenario: Scenario, journal: Journal, middleware_lost: int) -> list[Verdict]:
    """Judge every declared check of a run that is complete, in the order of the schema."""
    checks = scenario.spec.checks
    verdicts = []
    for name in ("formation_error", "consensus_error"):
        below: Below | None = getattr(checks, name)
        if below is not None:
            verdicts.append(_below(name, below, journal))
    verdicts += [_recovery_time(check, scenario, journal) for check in checks.recovery_time or ()]
    if checks.min_separation is not None:
        verdicts.append(_min_separation(checks.min_separation, scenario, journal))
    if checks.max_age is not None:
        verdicts.append(_max_age(checks.max_age, scenario, journal))
    if checks.connected is not None:
        verdicts.append(_connected(checks.connected, scenario, journal))
    if checks.qp_infeasible is not None:
        failures = sum(series.qp_failures for series in journal.metrics.series.values())
        verdicts.append(_at_most("qp_infeasible", checks.qp_infeasible, failures))
    if checks.ledger is not None:
        unbalanced = journal.ledger.unbalanced()
        found = "balanced" if not unbalanced else ", ".join(f"{s}->{d} off by {n}" for (s, d), n in unbalanced.items())
        verdicts.append(Verdict("ledger", not unbalanced, "balanced", found))
    if checks.middleware_loss is not None:
        verdicts.append(_at_most("middleware_loss", checks.middleware_loss, middleware_lost))
    return verdicts


def _below(name: str, check: Below, journal: Journal) -> Verdict:
    after_s = check.after / 1e9
    who = None if check.vehicles is None else vehicle_numbers(check.vehicles)
    value, vehicle, at_s = journal.metrics.worst("formation" if name == "formation_error" else "e", after_s, who)
    asked = f"below {check.below:g} m after {after_s:g} s{_of(check.vehicles)}"
    if vehicle == 0:
        return Verdict(name, False, asked, f"the run ended at {at_s:g} s, before the check begins")
    return Verdict(name, value < check.below, asked, f"at most {value:.4g} m (vehicle {vehicle}, {at_s:g} s)")


def _recovery_time(check: Recovery, scenario: Scenario, journal: Journal) -> Verdict:
    asked = (
        f"{check.error} error within {check.within:g} m, less than {check.below / 1e9:g} s after fault {check.fault}"
    )
    asked += _of(check.vehicles)
    tick_s = scenario.tick_ns / 1e9
    end = max(
        (e.tick for e in journal.happened if e.fault == check.fault and e.action == "ends"), default=scenario.ticks
    )
    if end >= scenario.ticks:
        return Verdict("recovery_time", False, asked, _ended(scenario, "the fault did"))
    later = (e for e in journal.happened if e.action == "begins" and e.tick >= end and e.fault != check.fault)
    disturbed = next(later, None)
    span = end, scenario.ticks + 1 if disturbed is None else disturbed.tick
    until = "the run ends" if disturbed is None else f"fault {disturbed.fault} begins at {disturbed.tick * tick_s:g} s"
    who = None if check.vehicles is None else vehicle_numbers(check.vehicles)
    what = "formation" if check.error == "formation" else "e"
    at_s, vehicle, off_m = journal.metrics.settled(what, span, check.within, who)
    if vehicle == 0:
        return Verdict("recovery_time", False, asked, f"{until}, before any frame of the log")
    if at_s is None:
        return Verdict("recovery_time", False, asked, f"{off_m:.4g} m (vehicle {vehicle}) when {until}")
    took = round(at_s / tick_s) - end
    passed = took * scenario.tick_ns < check.below
    return Verdict("recovery_time", passed, asked, f"{took * tick_s:g} s (vehicle {vehicle} the last)")


def _min_separation(check: MinSeparation, scenario: Scenario, journal: Journal) -> Verdict:
    asked = f"above {check.above:g} m after {check.after / 1e9:g} s{_of(check.vehicles)}"
    if scenario.vehicles < 2:
        return Verdict("min_separation", True, asked, "one vehicle")
    least = None if journal.separation is None else journal.separation.least
    if least is None:
        return Verdict("min_separation", False, asked, _ended(scenario, "the check begins"))
    i, j = least.pair
    found = f"at least {least.distance_m:.4g} m (vehicles {i} and {j}, {least.tick * scenario.tick_ns / 1e9:g} s)"
    return Verdict("min_separation", least.distance_m > check.above, asked, found)


def _max_age(check: MaxAge, scenario: Scenario, journal: Journal) -> Verdict:
    some = f", links {check.links}" if check.links != "*" else ""
    asked = f"below {check.below / 1e9:g} s after {check.after / 1e9:g} s{some}"
    links = sorted(select(parse_selector(check.links), scenario.graph.links))
    if not links:
        return Verdict("max_age", True, asked, "no link")
    oldest = journal.ages.oldest(-(-check.after // scenario.tick_ns), links)
    if oldest is None:
        return Verdict("max_age", False, asked, _ended(scenario, "the check begins"))
    age, (src, dst), tick = oldest
    tick_s = scenario.tick_ns / 1e9
    found = f"at most {age * tick_s:g} s (link {src}->{dst}, {tick * tick_s:g} s)"
    return Verdict("max_age", age * scenario.tick_ns < check.below, asked, found)


def _connected(check: Connected, scenario: Scenario, journal: Journal) -> Verdict:
    asked = f"in every window of {check.window / 1e9:g} s after {check.after / 1e9:g} s{_of(check.vehicles)}"
    found = journal.connectivity
    if found is None or not found.windows:
        return Verdict("connected", False, asked, _ended(scenario, "the first window did"))
    if found.trivial:
        return Verdict("connected", True, asked, "each follows the reference itself")
    if found.first is None:
        return Verdict("connected", True, asked, f"in all {found.windows} windows")
    tick_s = scenario.tick_ns / 1e9
    begin, end, unreached = found.first
    missed = f"{names(unreached)} not reached in the window that ends at {begin * tick_s:g} s, some until "
    missed += f"{(end - 1) * tick_s:g} s; {found.ticks} of {found.windows} windows"
    missed += f", {found.outages} stretches" if found.outages > 1 else ""
    return Verdict("connected", False, asked, missed)


def _of(vehicles: str | None) -> str:
    return "" if vehicles is None else f", vehicles {vehicles}"


def _ended(scenario: Scenario, before: str) -> str:
    return f"the run ended at {scenario.duration_ns / 1e9:g} s, before {before}"


def _at_most(name: str, check: AtMost, found: int) -> Verdict:
    return Verdict(name, found <= check.at_most, f"at most {check.at_most}", str(found))
