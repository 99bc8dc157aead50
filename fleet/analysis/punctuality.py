"""Did a run on a wall clock keep to it? Nothing late: on time. Anything late: degraded, with what and how much."""

from __future__ import annotations

from typing import Any

from fleet.checks.verdict import Verdict

ON_TIME, DEGRADED = "on time", "degraded"
MOST_MISSED = 0.01  # share of its ticks that an agent may miss by default


def label(timing: dict[str, Any]) -> tuple[str, list[str]]:
    """`on time` or `degraded`, and every reason.

    Args:
        timing: what world and netem measured, as in `result.json`.
    """
    world, network, vehicles = timing["world"], timing["netem"], timing["vehicles"]
    reasons = []
    missed = {i: row for i, row in vehicles.items() if row["missed"]}
    if missed:
        i, worst = max(missed.items(), key=lambda item: _share(item[1]))
        others = f", and {len(missed) - 1} more vehicles missed some" if len(missed) > 1 else ""
        reasons.append(
            f"agent {i} missed {worst['missed']} of {worst['asked']} ticks ({_share(worst):.2%}), "
            f"{worst['longest']} in a row at most{others}"
        )
    silent = {i: row["silent"] for i, row in vehicles.items() if row["silent"]}
    if silent:
        i = max(silent, key=lambda i: int(silent[i]))
        others = f", and {len(silent) - 1} more were" if len(silent) > 1 else ""
        seconds = silent[i] * world["period_ms"] / 1e3
        reasons.append(f"agent {i} was silent for {seconds:.3g} s in all, suspended or stuck{others}")
    if late := sum(network["late"].values()) + sum(network["missed"].values()):
        reasons.append(f"{late} transmissions came late or not at all")
    if network["overdue"]:
        total = network["hop"]["count"]
        reasons.append(f"{network['overdue']} of {total} deliveries were used after the tick at which they were due")
    if world["slipped_s"]:
        reasons.append(f"the world itself was late and moved the clock by {world['slipped_s']:.3g} s in all")
    if world["held_s"]:
        reasons.append(f"the clock stood still for {world['held_s']:.3g} s: paused, or somebody had to start")
    return (DEGRADED if reasons else ON_TIME), reasons


def verdict(timing: dict[str, Any], most_missed: float) -> Verdict:
    """Whether no agent missed more than a share of its ticks, nor the clock was moved by more than that."""
    name, reasons = label(timing)
    found = f"{name}: {'; '.join(reasons)}" if reasons else name
    value, asked = max(missed_share(timing), moved_share(timing)), f"at most {most_missed:.3g} of all ticks missed"
    return Verdict("on_time", value <= most_missed, asked, found, value, most_missed, "1")


def missed_share(timing: dict[str, Any]) -> float:
    """The share of its ticks that the worst agent missed."""
    return max(map(_share, timing["vehicles"].values()), default=0.0)


def moved_share(timing: dict[str, Any]) -> float:
    """By what share of the run the world moved the clock, because it was late itself."""
    slipped_s, run_s = float(timing["world"]["slipped_s"]), float(timing["world"]["run_s"])
    return slipped_s / max(1e-9, run_s)


def summary(timing: dict[str, Any], speed: float) -> str:
    """In one line, what one wants to know first."""
    responses = [row["response"] for row in timing["vehicles"].values() if row["response"]["count"]]
    hop, margin = timing["netem"]["hop"], timing["netem"]["margin"]
    said = [f"clock: real, {speed:g} x, a tick every {timing['world']['period_ms']:g} ms"]
    if responses:
        slow = max(responses, key=lambda row: float(row["p99_ms"]))
        said.append(f"slowest agent answers in {slow['p50_ms']:.2g} ms (median), {slow['p99_ms']:.2g} ms (p99)")
    if hop["count"]:
        early = f"{hop['count'] - margin['negative']} of {hop['count']} deliveries in time"
        said.append(f"network to agent {hop['p50_ms']:.2g} ms (median), {hop['p99_ms']:.2g} ms (p99), {early}")
    return "; ".join(said)


def _share(row: dict[str, Any]) -> float:
    missed, asked = int(row["missed"]), int(row["asked"])
    return missed / max(1, asked)
