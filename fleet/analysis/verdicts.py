"""Verdicts: the checks that a scenario declares, judged on what the run recorded, at its end or so far."""

from __future__ import annotations

from math import inf
from typing import Any

from fleet.errors import printable
from fleet.quantities import vehicle_names, vehicle_numbers
from fleet.recorder.journal import Journal
from fleet.result.verdict import Moment, Verdict
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import (
    EVERY,
    AtMost,
    Below,
    Connected,
    MaxAge,
    MinSeparation,
    Recovery,
    Standing,
    Tumbled,
)
from fleet.scenario.schema.programs import DONE, RUNNING, expected_ending
from netem.condition import Link
from netem.link_selector import parse_selector, select

PROGRAMS = "programs"


def judge(scenario: Scenario, journal: Journal, middleware_lost: int) -> list[Verdict]:
    """Judge every declared check, in the order of the schema. A run that is still going is judged as if it ended now.

    A check without data, or without the time that it needs, is not judged.
    """
    checks = scenario.spec.checks
    verdicts = []
    for name in ("formation_error", "consensus_error"):
        below: Below | None = getattr(checks, name)
        if below is not None:
            verdicts.append(_judge_below(name, below, scenario, journal))
    for check in checks.recovery_time or ():
        verdicts += _recovery_times(check, scenario, journal)
    for name, judged in (("min_separation", _min_separation), ("max_age", _max_age), ("connected", _judge_connected)):
        if (declared := getattr(checks, name)) is not None:
            verdicts.append(judged(declared, scenario, journal))
    # These two always apply unless they are waived. Otherwise a run with `checks: {ledger: balanced}` would pass with
    # three of four vehicles lost.
    tumbled, deaths = checks.tumbled or Tumbled(), checks.deaths or Standing()
    if not tumbled.waived and not scenario.nodes:
        verdicts.append(_judge_tumbled(tumbled, scenario, journal))
    if not deaths.waived and not scenario.nodes:
        verdicts.append(_deaths(deaths, scenario, journal))
    if scenario.spec.names is not None:
        verdicts.append(_programs_of_nodes(scenario, journal))
    elif journal.failures.count and checks.programs is None:
        verdicts.append(_programs(scenario, journal))
    failures = journal.metrics.qp_failures()
    if checks.qp_infeasible is not None:
        verdicts.append(_at_most("qp_infeasible", checks.qp_infeasible, sum(failures.values())))
    elif failures and not scenario.nodes:
        most = max(failures, key=lambda i: failures[i])
        who = f" (most of them vehicle {most}: {failures[most]})" if failures[most] else ""
        found = f"{sum(failures.values())}{who}"
        verdicts.append(Verdict("qp_infeasible", True, "reported", found, sum(failures.values()), None, "times"))
    if checks.ledger is not None:
        unbalanced = journal.ledger.unbalanced_links()
        found = ", ".join(f"{scenario.link_name(link)} off by {n}" for link, n in unbalanced.items()) or "balanced"
        verdicts.append(_judge_count("ledger", len(unbalanced), 0, "links", "balanced", found))
    if checks.middleware_loss is not None:
        verdicts.append(_at_most("middleware_loss", checks.middleware_loss, middleware_lost))
    if journal.checks is not None:
        verdicts += journal.checks.verdicts(over=journal.complete)
    return verdicts


OF_THE_END = frozenset({"ledger", "middleware_loss"})  # packets that are on their way are in no account yet


def standing(scenario: Scenario, journal: Journal) -> list[dict[str, Any]]:
    """The checks of a run that is still going: rows with check, asked, found and passed. None: no verdict yet."""
    rows = []
    for verdict in judge(scenario, journal, middleware_lost=0):
        is_open = not verdict.judged or verdict.check in OF_THE_END
        rows.append({
            "check": verdict.check,
            "asked": verdict.asked,
            "passed": None if is_open else verdict.passed,
            "found": "" if is_open else verdict.found,
        })  # fmt: skip
    return rows


def _judge_below(name: str, check: Below, scenario: Scenario, journal: Journal) -> Verdict:
    after_s = check.after / 1e9
    who = None if check.vehicles is None else vehicle_numbers(check.vehicles)
    what = "formation" if name == "formation_error" else "e"
    value, vehicle, at_s = journal.metrics.worst(what, after_s, who)
    asked = f"below {check.below:g} m after {after_s:g} s{_of_vehicles(check.vehicles)}"
    if vehicle == 0:
        found = f"the run ended at {at_s:g} s, before the check begins"
        return Verdict(name, False, asked, found, None, check.below, "m", judged=False)
    found, passed = f"at most {value:.4g} m (vehicle {vehicle}, {at_s:g} s)", value < check.below
    if len(journal.metrics.series if who is None else who) > 1:
        found += f", the median vehicle {journal.metrics.median_worst(what, after_s, who):.4g} m"
    moment = None
    if not passed and (first := journal.metrics.first_over(what, check.below, after_s, who)) is not None:
        moment = _moment(journal, scenario, *first)
    verdict = Verdict(name, passed, asked, found, value, check.below, "m", moment)
    return verdict.with_margin(check.below - value, "m", at_s)


def _moment(journal: Journal, scenario: Scenario, at_s: float, vehicle: int) -> Moment:
    """When a check failed first, with the faults that were active."""
    tick, active = round(at_s * 1e9 / scenario.tick_ns), dict[str, None]()
    for event in journal.happened:
        if event.is_fault and event.tick <= tick:
            active.update({event.fault: None}) if event.action == "begins" else active.pop(event.fault, None)
    return Moment(tick, at_s, [vehicle], faults=list(active))


def _recovery_times(check: Recovery, scenario: Scenario, journal: Journal) -> list[Verdict]:
    """One verdict, or of every fault one for each that ended between the first frame and the last."""
    if check.fault != EVERY:
        return [_recovery_time(check, scenario, journal)]
    first = journal.metrics.times[0] if journal.metrics.times else inf
    ended = [
        event.fault
        for event in journal.happened
        if event.is_fault and event.action == "ends"
        if first <= event.tick * scenario.tick_ns / 1e9 and event.tick < scenario.ticks
    ]
    each = [check.model_copy(update={"fault": name}) for name in dict.fromkeys(ended)]
    if not each:
        return [_no_recovery(check, "no fault ended while the run lasted")]
    return [_recovery_time(one, scenario, journal) for one in each]


def _asked_recovery(check: Recovery) -> str:
    return (
        f"{check.error} error within {check.within:g} m, less than {check.below / 1e9:g} s after "
        f"{'every fault' if check.fault == EVERY else f'fault {check.fault}'}{_of_vehicles(check.vehicles)}"
    )


def _no_recovery(check: Recovery, found: str) -> Verdict:
    asked = _asked_recovery(check)
    return Verdict("recovery_time", False, asked, found, None, check.below / 1e9, "s", judged=False)


def _nearest_recovery(check: Recovery, what: str, span_s: tuple[float, float], journal: Journal) -> float:
    """Quantitative semantics of "eventually in time, and then to the end": how far below the limit errors stayed [m].

    Since it is for the rest of the span, the latest begin that is in time is the best one.
    """
    begin, end = span_s
    times, in_time = journal.metrics.times, begin + check.below / 1e9
    latest = max((t for t in times if begin <= t < min(in_time, end)), default=inf)
    who = None if check.vehicles is None else vehicle_numbers(check.vehicles)
    return check.within - journal.metrics.worst(what, latest, who, end)[0]


def _recovery_time(check: Recovery, scenario: Scenario, journal: Journal) -> Verdict:
    tick_ns, tick_s = scenario.tick_ns, scenario.tick_ns / 1e9
    end = max(
        (e.tick for e in journal.happened if e.fault == check.fault and e.action == "ends"), default=scenario.ticks
    )
    if end >= scenario.ticks:
        return _no_recovery(check, _ended(scenario, "the fault did"))
    begun = (e for e in journal.happened if e.is_fault and e.action == "begins")
    later = (e for e in begun if e.tick >= end and e.fault != check.fault)
    disturbed = next(later, None)
    span = end, scenario.ticks + 1 if disturbed is None else disturbed.tick
    until = "the run ends" if journal.complete else "this was judged"
    if disturbed is not None:
        until = f"fault {disturbed.fault} begins at {disturbed.tick * tick_s:g} s"
    who = None if check.vehicles is None else vehicle_numbers(check.vehicles)
    what = "formation" if check.error == "formation" else "e"
    margin_m = _nearest_recovery(check, what, (span[0] * tick_s, span[1] * tick_s), journal)
    at_s, vehicle, off_m, least_s = journal.metrics.find_settled(what, span, check.within, who)
    if at_s is None and disturbed is None and not journal.complete and (journal.written - end) * tick_ns < check.below:
        return _no_recovery(check, "there is still time")
    if vehicle == 0:
        return _no_recovery(check, f"{until}, before any frame of the log")
    asked, limit_s = _asked_recovery(check), check.below / 1e9
    if at_s is None:
        found = f"{off_m:.4g} m (vehicle {vehicle}) when {until}"
        if off_m < check.within:
            found += f", and not within {check.within:g} m for the last {least_s:.3g} s"
        return Verdict("recovery_time", False, asked, found, inf, limit_s, "s").with_margin(margin_m, "m")
    took = round(at_s / tick_s) - end
    passed = took * tick_ns < check.below
    found = f"{took * tick_s:g} s (vehicle {vehicle} the last)"
    return Verdict("recovery_time", passed, asked, found, took * tick_s, limit_s, "s").with_margin(margin_m, "m")


def _min_separation(check: MinSeparation, scenario: Scenario, journal: Journal) -> Verdict:
    asked = f"above {check.above:g} m after {check.after / 1e9:g} s{_of_vehicles(check.vehicles)}"
    if scenario.vehicles < 2:
        return Verdict("min_separation", True, asked, "one vehicle", None, check.above, "m")
    least = None if journal.separation is None else journal.separation.least
    if least is None:
        found = _ended(scenario, "the check begins")
        return Verdict("min_separation", False, asked, found, None, check.above, "m", judged=False)
    i, j = least.pair
    found = f"at least {least.distance_m:.4g} m (vehicles {i} and {j}, {least.tick * scenario.tick_ns / 1e9:g} s)"
    passed = least.distance_m > check.above
    verdict = Verdict("min_separation", passed, asked, found, least.distance_m, check.above, "m")
    return verdict.with_margin(least.distance_m - check.above, "m", least.tick * scenario.tick_ns / 1e9)


def _max_age(check: MaxAge, scenario: Scenario, journal: Journal) -> Verdict:
    some = f", links {check.links}" if check.links != "*" else ""
    asked = f"below {check.below / 1e9:g} s after {check.after / 1e9:g} s{some}"
    links = sorted({*select(parse_selector(check.links), scenario.graph.links)}.intersection(journal.ages.begun))
    if not links and scenario.nodes:
        return Verdict("max_age", False, asked, "nothing was sent", None, check.below / 1e9, "s", judged=False)
    if not links:
        return Verdict("max_age", True, asked, "no link", None, check.below / 1e9, "s")
    oldest = _oldest(journal, -(-check.after // scenario.tick_ns), links)
    if oldest is None:
        found = _ended(scenario, "the check begins")
        return Verdict("max_age", False, asked, found, None, check.below / 1e9, "s", judged=False)
    age, (src, dst), tick = oldest
    tick_s = scenario.tick_ns / 1e9
    found = f"at most {age * tick_s:g} s (link {scenario.link_name((src, dst))}, {tick * tick_s:g} s)"
    passed = age * scenario.tick_ns < check.below
    verdict = Verdict("max_age", passed, asked, found, age * tick_s, check.below / 1e9, "s")
    return verdict.with_margin(check.below / 1e9 - age * tick_s, "s", tick * tick_s)


def _oldest(journal: Journal, after: int, links: list[Link]) -> tuple[int, Link, int] | None:
    """The largest age on some links from a tick on: (age [ticks], link, tick)."""
    oldest = journal.ages.oldest(after, links)
    now = journal.written
    if journal.complete or now < after:
        return oldest
    for link in links:  # the ages that grow now are not counted before something arrives, or the run ends
        age = now - journal.ages.links[link].heard
        if oldest is None or age > oldest[0]:
            oldest = age, link, now
    return oldest


def _judge_connected(check: Connected, scenario: Scenario, journal: Journal) -> Verdict:
    asked = f"in every window of {check.window / 1e9:g} s after {check.after / 1e9:g} s{_of_vehicles(check.vehicles)}"
    found = journal.connectivity
    if found is not None and not journal.complete:
        found = found.so_far(journal.written + 1)
    if found is None or not found.windows:
        words = _ended(scenario, "the first window did")
        return Verdict("connected", False, asked, words, None, 0, "windows", judged=False)
    if found.trivial:
        found_none = "each follows the reference itself"
        return Verdict("connected", True, asked, found_none, 0, 0, "windows").with_margin(0, "windows")
    if found.first is None:
        words = f"in all {found.windows} windows"
        return Verdict("connected", True, asked, words, 0, 0, "windows").with_margin(0, "windows")
    tick_s = scenario.tick_ns / 1e9
    begin, end, unreached = found.first
    missed = f"{vehicle_names(unreached)} not reached in the window that ends at {begin * tick_s:g} s, some until "
    missed += f"{(end - 1) * tick_s:g} s; {found.ticks} of {found.windows} windows"
    missed += f", {found.outages} stretches" if found.outages > 1 else ""
    verdict = Verdict("connected", False, asked, missed, found.ticks, 0, "windows")
    return verdict.with_margin(-found.ticks, "windows", begin * tick_s)


def _of_vehicles(vehicles: str | None) -> str:
    return "" if vehicles is None else f", vehicles {vehicles}"


def _ended(scenario: Scenario, before: str) -> str:
    return (
        f"the run ended at {scenario.duration_ns / 1e9:g} s, before {before}"
        if scenario.ends
        else f"it ended before {before}"
    )


def _judge_tumbled(check: Tumbled, scenario: Scenario, journal: Journal) -> Verdict:
    who = None if check.vehicles is None else vehicle_numbers(check.vehicles)
    spells = [spell for spell in journal.tumbles if who is None or spell.vehicle in who]
    tick_s = scenario.tick_ns / 1e9
    found = "0"
    if spells:
        vehicles = sorted({spell.vehicle for spell in spells})
        first = spells[0]
        found = f"{len(spells)}, {vehicle_names(vehicles)}, first vehicle {first.vehicle} at {first.begin * tick_s:g} s"
        if lasting := sorted({spell.vehicle for spell in spells if spell.end is None}):
            found += f", to the end {vehicle_names(lasting)}"
    asked = f"at most {check.at_most}{_of_vehicles(check.vehicles)}"
    return _judge_count("tumbled", len(spells), check.at_most, "times", asked, found)


def _deaths(check: Standing, scenario: Scenario, journal: Journal) -> Verdict:
    tick_s = scenario.tick_ns / 1e9
    died = len(journal.died)
    found = ", ".join([str(died), *(f"{e.what} at {e.tick * tick_s:g} s" for e in journal.died[:4])])
    asked = f"at most {check.at_most} that no fault asked for"
    return _judge_count("deaths", died, check.at_most, "times", asked, found)


def _programs(scenario: Scenario, journal: Journal) -> Verdict:
    """Agents that are programs of others, of which some have failed; as long as none has, the check is not shown."""
    failures = journal.failures
    each = [f"vehicle {one.vehicle}: {one.words}" for one in failures.first[:4]]
    found = printable("; ".join(each)) + (f" and {failures.count - 4} more" if failures.count > 4 else "")
    first = failures.first[0]
    moment = _moment(journal, scenario, first.at_ns / 1e9, first.vehicle)
    verdict = Verdict(PROGRAMS, False, "none fails", found, failures.count, 0, "programs", moment)
    return verdict.with_margin(-failures.count, "programs", first.at_ns / 1e9)


def _programs_of_nodes(scenario: Scenario, journal: Journal) -> Verdict:
    """Whether the programs of what were nodes ran, or did their work, as on the wall clock."""
    asked: dict[str, str] = {**(scenario.spec.checks.programs or {"*": RUNNING})}
    failures = journal.failures
    bad: list[tuple[int, int, str]] = []  # when [ns], whose, and in words
    failed = {one.vehicle: one for one in reversed(failures.first)}
    for i, name in enumerate(scenario.spec.names or (), start=1):
        want, ended = expected_ending(asked, name, name), failures.ended.get(i)
        if (one := failed.get(i)) is not None:
            bad.append((one.at_ns, i, f"{name} {one.words}"))
        elif want == DONE and ended is None:
            bad.append((scenario.duration_ns, i, f"{name} did not end"))
        elif want == RUNNING and ended is not None:
            bad.append((ended, i, f"{name} ended at {ended / 1e9:.2f} s"))
    words = (
        ", ".join(dict.fromkeys(asked.values()))
        if list(asked) == ["*"]
        else ", ".join(f"{name} {what}" for name, what in asked.items())
    )
    if not bad:
        all_of_them = f"all {len(scenario.spec.names or ())}"
        sent = any(account.sent for account in journal.ledger.accounts.values())
        if RUNNING in asked.values() and journal.complete and not (sent or failures.spoke):
            return Verdict(PROGRAMS, False, words, all_of_them + NOTHING_AT_ALL)
        return Verdict(PROGRAMS, True, words, all_of_them, 0, 0, "programs")
    found = "; ".join(text for _, _, text in bad[:4]) + (f" and {len(bad) - 4} more" if len(bad) > 4 else "")
    at_ns, vehicle, _ = min(bad)
    moment = _moment(journal, scenario, at_ns / 1e9, vehicle)
    verdict = Verdict(PROGRAMS, False, words, printable(found), len(bad), 0, "programs", moment)
    return verdict.with_margin(-len(bad), "programs", at_ns / 1e9)


# Such a run has shown nothing: they wait for each other, or reach each other behind our back. Programs that were to end
# have done so, and may be quiet.
NOTHING_AT_ALL = ", and none of them sent or printed anything"
OF_THE_TOOL = frozenset({"deaths", "ledger", "middleware_loss"})  # `expect: fail` judges the protocol, not this program


def judge_expected(scenario: Scenario, verdicts: list[Verdict]) -> Verdict | None:
    """Whether a run that is meant to fail did; checks of our own processes must pass all the same."""
    if scenario.spec.expect == "pass":
        return None
    failed = [verdict.check for verdict in verdicts if verdict.failed]
    ours = [check for check in failed if check in OF_THE_TOOL]
    found = ", ".join(dict.fromkeys(failed)) or "every check passed"
    asked = f"a check fails, and none of {', '.join(sorted(OF_THE_TOOL))}"
    return Verdict("expect", bool(failed) and not ours, asked, found, len(failed), None, "checks")


def _at_most(name: str, check: AtMost, found: int) -> Verdict:
    unit = "messages" if name == "middleware_loss" else "times"
    return _judge_count(name, found, check.at_most, unit, f"at most {check.at_most}", str(found))


def _judge_count(name: str, count: int, at_most: int, unit: str, asked: str, found: str) -> Verdict:
    return Verdict(name, count <= at_most, asked, found, count, at_most, unit).with_margin(at_most - count, unit)
