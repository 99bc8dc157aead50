"""Did a run on a wall clock keep to it? Nothing late: on time. Anything late: degraded, with what and how much."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any

from msgspec import convert

from fleet.result.timing import Punctual, Spread, Timing
from fleet.result.verdict import Verdict
from fleet.scenario.schema.checks import PunctualCheck
from netem.histogram import PER_DECADE

ON_TIME, DEGRADED = "on time", "degraded"


def timing_of(values: Mapping[str, Any], speed: float) -> Timing | None:
    """The measurements of world and netem, with a label. `values`: what both answered when the run ended. `speed`:
    times real time that was asked. None: one of them did not answer.
    """
    if not (values.get("world") and values.get("netem")):
        return None
    timing = convert({**values, "speed": speed}, Timing)
    timing.label, timing.reasons = _label(timing)
    return timing


def _label(timing: Timing) -> tuple[str, list[str]]:
    """`on time` or `degraded`, and every reason."""
    world, network, vehicles = timing.world, timing.netem, timing.vehicles
    reasons = []
    missed = {i: row for i, row in vehicles.items() if row.missed}
    if missed:
        i, worst = max(missed.items(), key=lambda item: item[1].missed_share)
        others = f", and {len(missed) - 1} more vehicles missed some" if len(missed) > 1 else ""
        reasons.append(
            f"agent {i} missed {worst.missed} of {worst.asked} ticks ({worst.missed_share:.2%}), "
            f"{worst.longest} in a row at most{others}"
        )
    silent = {i: row.silent for i, row in vehicles.items() if row.silent}
    if silent:
        i = max(silent, key=silent.__getitem__)
        others = f", and {len(silent) - 1} more were" if len(silent) > 1 else ""
        seconds = silent[i] * world.period_ms / 1e3
        reasons.append(f"agent {i} was silent for {seconds:.3g} s in all, suspended or stuck{others}")
    if late := sum(network.late.values()) + sum(network.missed.values()):
        reasons.append(f"{late} transmissions came late or not at all")
    if network.overdue:
        total = network.hop.count
        reasons.append(f"{network.overdue} of {total} deliveries were used after the tick at which they were due")
    if world.slipped_s:
        reasons.append(f"the world itself was late and moved the clock by {world.slipped_s:.3g} s in all")
    if world.held_s:
        reasons.append(f"the clock stood still for {world.held_s:.3g} s: paused, or somebody had to start")
    return (DEGRADED if reasons else ON_TIME), reasons


def verdict(timing: Timing, most_missed: float) -> Verdict:
    """Whether no agent missed more than a share of its ticks, nor the clock was moved by more than that."""
    found = f"{timing.label}: {'; '.join(timing.reasons)}" if timing.reasons else timing.label
    moved = timing.world.slipped_s / max(1e-9, timing.world.run_s)
    value = max(moved, *(row.missed_share for row in timing.vehicles.values()), 0.0)
    asked = f"at most {most_missed:.3g} of all ticks missed"
    judged = Verdict("on_time", value <= most_missed, asked, found, value, most_missed, "1")
    return judged.with_margin(most_missed - value, "1")


def summary(timing: Timing) -> str:
    responses = [row.response for row in timing.vehicles.values() if row.response.count]
    hop, margin = timing.netem.hop, timing.netem.margin
    said = [f"clock: real, {timing.speed:g} x, a tick every {timing.world.period_ms:g} ms"]
    if responses:
        slow = max(responses, key=lambda spread: spread.p99_ms)
        said.append(f"slowest agent answers in {_time(slow.p50_ms)} (median), {_time(slow.p99_ms)} (p99)")
    if hop.count:
        early = f"{hop.count - margin.negative} of {hop.count} deliveries in time"
        said.append(f"network to agent {_time(hop.p50_ms)} (median), {_time(hop.p99_ms)} (p99), {early}")
    return "; ".join(said)


def punctual(found: Punctual, asked: PunctualCheck | None) -> Verdict:
    """Whether a network of nodes handed messages over when they were due, and took them when they came, and whether its
    programs got a processor when they could run: what is late here, the host has delayed, and not the network that was
    asked for. Messages and probes are judged together, and the programs of each node, by the lower end of the share's
    interval, so that two late ones of few fail nothing.
    """
    asked = asked or PunctualCheck()
    limit_ms = asked.late / 1e6
    count = found.late.count + found.came.count
    above = sum(later(spread, limit_ms) * spread.count for spread in (found.late, found.came))
    share, least = above / max(1, count), wilson_low(above, count)
    words = f"at most {asked.at_most * 100:g} % later than {limit_ms:g} ms"
    late, came = found.late, found.came
    said = f"{share:.2%} of messages and probes, at least {least:.2%}; handed over {_time(late.p50_ms)} (p50), "
    said += f"{_time(late.p99_ms)} (p99), {_time(late.max_ms)} (worst) after the due time; "
    said += f"taken within {_time(came.p99_ms)} (p99)"
    if found.programs:
        node, delayed, low = max(
            (_delay_of(*item, limit_ms) for item in found.programs.items()), key=lambda row: row[2]
        )
        said += f"; programs of {node} waited longer for a processor in {delayed:.2%} of the times in which they ran, "
        said += f"at least {low:.2%}"
        least = max(least, low)
    verdict = Verdict("punctual", least <= asked.at_most, words, said, least, asked.at_most, "1")
    return verdict.with_margin(asked.at_most - least, "1")


def _delay_of(node: str, waits: Spread, limit_ms: float) -> tuple[str, float, float]:
    """A node, how much of the time its programs were delayed, and the lower end of the interval of that share."""
    share = later(waits, limit_ms)
    return node, share, wilson_low(share * waits.count, waits.count)


def _time(ms: float) -> str:
    """A time in words."""
    return f"{ms:.3g} ms" if ms < 999.5 else f"{ms / 1e3:.3g} s"


def wilson_low(hits: float, count: int) -> float:
    """The lower end of the Wilson score interval of a share, with 95 %; 0 of nothing."""
    if not hits:
        return 0.0
    share, z2 = hits / count, 1.959964**2
    spread = sqrt(z2 * (share * (1.0 - share) / count + z2 / (4.0 * count**2)))
    return (share + z2 / (2.0 * count) - spread) / (1.0 + z2 / count)


def later(spread: Spread, limit_ms: float) -> float:
    """The share of a spread that lies above a limit, to the accuracy of its histogram."""
    above = sum(count for edge, count in spread.histogram_ms if edge > limit_ms * 10.0 ** (1.0 / PER_DECADE))
    return above / max(1, spread.count)
