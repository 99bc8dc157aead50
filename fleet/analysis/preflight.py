"""Warnings before a run: checks that cannot pass, faults that do nothing, a large log.

They are no errors, because `--duration` may shorten a run until checks cannot be judged, and faults may be injected
live.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from itertools import combinations
from math import ceil, dist, log

from agents.config import Law
from agents.plugins.laws import load
from fleet.analysis.link_shares import short_traces
from fleet.analysis.slots import slot_warnings
from fleet.analysis.stability import oldest_s
from fleet.quantities import show_time, vehicle_names, vehicle_numbers
from fleet.recorder.settling import least_s
from fleet.scenario.faults.kinds import OF_ROBOTS
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import EVERY
from fleet.scenario.schema.keep_apart import KeepApartSection
from netem.condition import DEFAULT_LIMIT, Link
from netem.correlation import effective
from world.errors import PluginError
from world.vectors import Vec3, plus

LARGE_MB = 50.0  # from which on a warning about the size is given
MESSAGE_BYTES = 70  # in a log, compressed and indexed: 68 to 72 measured with 3, 4 and 12 vehicles
THIN = "log: {every: 10 ticks}"
_MANY = 100  # packets per second
BY_ROUND = OF_ROBOTS  # faults that act at round ticks only
PARAMETER = "forget_after_s"
RARE = 1e-5  # probability of such a silence that does no harm (docs/guide/protocols/average.md, High loss)


def warnings(scenario: Scenario) -> list[str]:
    """One sentence for each setting that is valid and hardly intended."""
    found = [
        *check_warnings(scenario),
        *_idle_faults(scenario),
        *_correlation_warnings(scenario),
        *_short_queues(scenario),
    ]
    found += [*forgetting_warnings(scenario), *keep_apart_warnings(scenario)]
    found += [*short_traces(scenario), *slot_warnings(scenario)]
    if scenario.spec.log.snapshot is not None:
        found.append("log.snapshot has no effect: a run goes on from any moment of its log; leave it out")
    if hint := large_log_hint(log_mb(scenario)):
        found.append(f"the log will have about {log_mb(scenario):.0f} MB; {hint}")
    return found


def check_warnings(scenario: Scenario) -> list[str]:
    """One sentence for each check that cannot pass, or hardly."""
    return [*_never_judged(scenario), *_recoveries(scenario), *_too_near(scenario), *_too_old(scenario)]


def log_mb(scenario: Scenario) -> float:
    """About how large the log of a whole run becomes [MB]."""
    if scenario.spec.log.none:
        return 0.0
    rows = sum(scenario.vehicles * (scenario.ticks // every + 1) for every in scenario.log_every.values() if every)
    packets = len(scenario.graph.links) * (scenario.ticks // scenario.round_ticks)
    return (rows + packets) * MESSAGE_BYTES / 1e6


def large_log_hint(megabytes: float) -> str:
    """What to do about it; empty for a log of usual size."""
    hint = f"{THIN} thins it to a tenth (fleet whatif needs log.nav and log.command: 1 tick)"
    return hint if megabytes > LARGE_MB else ""


def _never_judged(scenario: Scenario) -> Iterator[str]:
    checks, end = scenario.spec.checks, scenario.duration_ns
    for name in ("formation_error", "consensus_error", "min_separation", "max_age"):
        check = getattr(checks, name)
        # Ages are those of ticks that are started; errors and distances have one more frame, at the end.
        if check is not None and (check.after > end or (name == "max_age" and check.after >= end)):
            when = f"after {check.after / 1e9:g} s, and the run ends at {end / 1e9:g} s"
            yield f"checks.{name} cannot pass: it begins {when}"
    connected = checks.connected
    if connected is not None and connected.after + connected.window > end:
        yield (
            f"checks.connected cannot pass: its first window ends at {(connected.after + connected.window) / 1e9:g} s, "
            f"and the run at {end / 1e9:g} s"
        )


def _recoveries(scenario: Scenario) -> Iterator[str]:
    events, last, tick_s = scenario.faults.events, scenario.ticks, scenario.tick_ns / 1e9
    ends = {event.fault: event.tick for event in events if event.action == "ends"}
    asked = dict.fromkeys(check.fault for check in scenario.spec.checks.recovery_time or ())
    if EVERY in asked and not any(end < last for end in ends.values()):
        yield "checks.recovery_time cannot pass: no fault ends before the run does, unless you inject one"
    for name in ends if EVERY in asked else asked:
        end = ends.get(name, last)
        if end >= last:
            if name in asked:
                yield f"checks.recovery_time cannot pass: the run ends at {last * tick_s:g} s, before fault {name} does"
            continue
        next_one = next((e for e in events if e.action == "begins" and e.fault != name and e.tick >= end), None)
        if next_one is not None and next_one.tick == end:
            yield (
                f"checks.recovery_time cannot pass: fault {next_one.fault} begins when fault {name} ends, at "
                f"{end * tick_s:g} s, which leaves no time to recover"
            )
            continue
        left_s = ((last if next_one is None else next_one.tick) - end) * tick_s
        if (needed_s := least_s(scenario.disturbance, left_s)) > left_s:
            yield (
                f"checks.recovery_time cannot pass: fault {name} leaves {left_s:g} s to recover, and in this "
                f"disturbance an error must stay within its limit for {needed_s:.3g} s"
            )


def _too_near(scenario: Scenario) -> Iterator[str]:
    check = scenario.spec.checks.min_separation
    if check is None or check.after > scenario.duration_ns:
        return
    who = vehicle_numbers(check.vehicles) if check.vehicles else range(1, scenario.vehicles + 1)
    places = {i: scenario.plans[i - 1].at(scenario.duration_ns / 1e9).position for i in who}
    near = min(((dist(places[i], places[j]), i, j) for i, j in combinations(sorted(places), 2)), default=None)
    if near is not None and near[0] <= check.above:
        yield (
            f"checks.min_separation can hardly pass: in the formation itself vehicles {near[1]} and {near[2]} end "
            f"{near[0]:.4g} m apart"
        )


def _too_old(scenario: Scenario) -> Iterator[str]:
    check = scenario.spec.checks.max_age
    if check is None or check.after >= scenario.duration_ns:
        return
    oldest = oldest_s(scenario)
    if check.below / 1e9 <= oldest:
        yield (
            f"checks.max_age can hardly pass: even without loss a message is up to {oldest:.4g} s old, "
            f"and the limit is {check.below / 1e9:g} s"
        )


def _idle_faults(scenario: Scenario) -> Iterator[str]:
    m, tick_s = scenario.round_ticks, scenario.tick_ns / 1e9
    times: dict[str, tuple[int, int | None]] = {}
    for fault in scenario.faults.network:
        if fault.kind in BY_ROUND:
            times.setdefault(fault.id, (fault.begin, fault.end))
    for name, (begin, end) in times.items():
        if end is not None and -(-begin // m) * m >= end:
            yield (
                f"fault {name} does nothing: agents talk at round ticks, every {m * tick_s:g} s, and no round tick "
                f"lies between {begin * tick_s:g} and {end * tick_s:g} s. Let the fault last for a round at least"
            )


def _short_queues(scenario: Scenario) -> Iterator[str]:
    """Queues that lose packets without a rate: as in the kernel, a packet stays in the queue until its delay is over.

    Vehicles send once a round. How often nodes send is unknown: a limit that is given, or fewer packets per second
    than _MANY, counts as short.
    """
    sent = _MANY if scenario.nodes else 1e9 / (scenario.round_ticks * scenario.tick_ns)
    short: dict[tuple[int, int], list[Link]] = {}  # by limit and delay
    for link, conditions in scenario.possible.items():
        queues = [(c.limit, c.delay_ns) for c in conditions if c.delay_ns and not c.rate_bit_s and c.up]
        limit, delay_ns = min(queues, key=lambda queue: queue[0] / queue[1], default=(0, 0))
        given = scenario.nodes and limit != DEFAULT_LIMIT
        if delay_ns and (given or limit * 1e9 / delay_ns < sent):
            short.setdefault((limit, delay_ns), []).append(link)
    for (limit, delay_ns), links in short.items():
        more = f" and {len(links) - 1} more" if len(links) > 1 else ""
        yield (
            f"link {scenario.link_name(links[0])}{more}: at most {limit * 1e9 / delay_ns:.4g} packets per second pass, "
            f"and more are lost with cause queue: as in the kernel, a packet takes one of the {limit} places of the "
            f"queue for the delay of {show_time(delay_ns)}. Give a larger limit, or a rate if a slow line is meant"
        )


def _correlation_warnings(scenario: Scenario) -> Iterator[str]:
    given = [c for its in scenario.possible.values() for c in its]
    given += [f.condition for f in scenario.faults.network if f.condition is not None]
    found: dict[str, None] = {}
    for condition in given:
        for word, p, rho, share in effective(condition):
            rate = "less than one packet in a million" if share < 1e-6 else f"{100 * share:.3g}% of the packets"
            gap = f" gap {condition.gap}" if word == "reorder" and condition.gap > 1 else ""
            found[
                f'"{word} {100 * p:g}% {100 * rho:g}%{gap}" affects {rate} in the long run, not {100 * p:g}%: the '
                "correlation keeps the random numbers near 50%, as in the kernel"
            ] = None
        if condition.jitter_ns and condition.delay_correlation:
            found[
                f"the correlation {100 * condition.delay_correlation:g}% of a delay has no effect, as in the kernel: "
                "delays keep their distribution, and each is independent of the one before"
            ] = None
    yield from found


def forgetting_warnings(scenario: Scenario) -> Iterator[str]:
    """A warning if all messages of `forget_after_s` may be lost, so that vehicles forget living neighbours."""
    period_s = scenario.round_ticks * scenario.tick_ns / 1e9
    forget_s = [None if control.agent is None else _forget_after_s(control.agent) for control in scenario.controls]
    worst: dict[float, tuple[float, Link]] = {}  # by how long agents wait: the largest loss, and its link
    for link, loss in _losses(scenario).items():
        after_s = forget_s[link[1] - 1]
        if after_s is not None and loss > worst.get(after_s, (0.0, link))[0]:
            worst[after_s] = loss, link
    for after_s, (loss, (src, dst)) in worst.items():
        needed_s = period_s * log(RARE) / log(loss)
        if after_s < needed_s:
            yield (
                f"agent {dst} takes a neighbour for gone after {PARAMETER} = {after_s:g} s, and the link {src}->{dst} "
                f"loses {100 * loss:g}% of the packets: all that come in this time are lost with a probability of "
                f"{loss ** int(after_s / period_s):.1g}; {PARAMETER}: {ceil(10 * needed_s) / 10:g} makes it {RARE:g}"
            )


def _losses(scenario: Scenario) -> dict[Link, float]:
    """The largest loss of each link that loses some packets, one by one; by itself or through a fault."""
    given = [*scenario.conditions.items()]
    for fault in scenario.faults.network:
        if fault.condition is not None:
            given += [(link, fault.condition) for link in fault.links]
    found: dict[Link, float] = {}
    for link, condition in given:
        if 0.0 < condition.loss < 1.0 and condition.loss_model is None and not condition.loss_correlation:
            found[link] = max(condition.loss, found.get(link, 0.0))
    return found


def _forget_after_s(law: Law) -> float | None:
    """The parameter's value, or its default; None of a law that has none, or may not be imported now."""
    given = law.parameters.get(PARAMETER)
    if given is None:
        try:
            parameter = inspect.signature(load("agent", law)).parameters.get(PARAMETER)
        except PluginError:
            return None
        given = None if parameter is None else parameter.default
    return float(given) if isinstance(given, int | float) else None


def keep_apart_warnings(scenario: Scenario) -> Iterator[str]:
    """One sentence for each; none without the section."""
    section = scenario.spec.keep_apart
    if section is None:
        return
    controls = list(enumerate(scenario.controls, start=1))
    agents = [i for i, control in controls if control.agent is not None]
    if agents:
        yield (
            f"keep_apart acts only within a FormationAgent: if the agent of {vehicle_names(agents)} has none, or "
            "commands the vehicle by itself, this vehicle does not keep apart, and the others do their half only"
        )
    without = [i for i, control in controls if control.agent is None and control.controller is not None]
    if without:
        yield (
            f"keep_apart acts between guidance and tracking: {vehicle_names(without)} with a law in place of both "
            f"{'does' if len(without) == 1 else 'do'} not keep apart, and the others do their half only"
        )
    links = set(scenario.graph.links)
    pairs = combinations(range(1, scenario.vehicles + 1), 2)
    deaf = [(i, j) for i, j in pairs if (i, j) not in links or (j, i) not in links]
    if deaf:
        more = f", and {len(deaf) - 1} more pairs like them" if len(deaf) > 1 else ""
        yield (
            f"keep_apart: vehicles {deaf[0][0]} and {deaf[0][1]} do not both hear each other{more}; a vehicle keeps "
            "apart from those that it hears, so add links to the graph"
        )
    steepest = max(abs(_climb(scenario, t)) for t in range(scenario.duration_ns // 1_000_000_000 + 1))
    if steepest > section.climb:
        yield (
            f"keep_apart: the course of a vehicle climbs or dives with up to {steepest:.3g} m/s, but keep_apart.climb "
            f"limits every command to {section.climb:g} m/s, so the vehicle falls behind"
        )
    yield from _obstacle_too_near("at the start", [eta[:3] for eta, _ in scenario.initial], section)
    end = scenario.duration_ns / 1e9
    place = scenario.reference.at(end).position
    there = [plan.at(end).position for plan in scenario.plans]
    yield from _obstacle_too_near("in the formation at the end", [plus(place, offset) for offset in there], section)


def _climb(scenario: Scenario, t: float) -> float:
    """The fastest climb or dive that any vehicle is to make at a time [s], downwards positive [m/s]."""
    down = scenario.reference.at(t).velocity[2]
    return max((down + plan.at(t).velocity[2] for plan in scenario.plans), key=abs)


def _obstacle_too_near(when: str, places: Sequence[Vec3], section: KeepApartSection) -> Iterator[str]:
    numbered = list(enumerate(places, start=1))
    pairs = [(dist(p, q), i, j) for (i, p), (j, q) in combinations(numbered, 2)]
    nearest = min(pairs, default=None)
    if nearest is not None and nearest[0] < section.distance:
        yield (
            f"keep_apart: {when} vehicles {nearest[1]} and {nearest[2]} are {nearest[0]:.4g} m apart, but "
            f"keep_apart.distance is {section.distance:g} m"
        )
    for number, obstacle in enumerate(section.obstacles, start=1):
        inside = [i for i, (north, east, _) in numbered if dist((north, east), obstacle.at) < obstacle.radius]
        if inside:
            verb = "is" if len(inside) == 1 else "are"
            yield f"keep_apart: {when} {vehicle_names(inside)} {verb} within obstacle {number}"
