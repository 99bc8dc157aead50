"""The ages of information that a run certainly reaches from a snapshot on, whatever is drawn after it.

A snapshot of tick S has the fates of all packets sent before S: they are in it, or lost. A packet sent at S or later
arrives L ticks after S at the earliest, so the ages of the ticks S to S + L - 1 are known.

A margin that leaves these ages out is late. When it gets smaller, the fate of the next packet is drawn already.
All runs that continue from there then share its fate, and new draws do not help.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from fleet.recorder.snapshot import Snapshot
from fleet.scenario.scenario import Scenario
from netem.condition import Link
from netem.grammar import parse_selector, select
from netem.medium import PERFECT
from netem.transit import PendingPacket


def certain_margin(scenario: Scenario) -> Callable[[Snapshot], float]:
    """Make a function that computes the margin of `max_age` [s] from a snapshot.

    It covers the ticks for which the snapshot already decides every age. If the margin is below 0, the check fails.
    """
    check = scenario.spec.checks.max_age
    assert check is not None
    tick_ns, after = scenario.tick_ns, -(-check.after // scenario.tick_ns)
    limit_s, tick_s = check.below / 1e9, tick_ns / 1e9
    ahead = {link: _known_ticks(scenario, link) for link in select(parse_selector(check.links), scenario.graph.links)}

    def margin(snapshot: Snapshot) -> float:
        on_the_way = _on_the_way(snapshot.network)
        heard = {(src, dst): sent for src, dst, sent in snapshot.heard}
        oldest = -1
        for link, ticks in ahead.items():
            some = range(max(after, snapshot.tick), min(snapshot.tick + ticks, scenario.ticks))
            oldest = max(oldest, _oldest(heard[link], on_the_way.get(link, ()), some))
        margin_s = limit_s - oldest * tick_s  # to the last bit that of the verdict: levels are compared with it
        return margin_s if oldest * tick_ns < check.below else min(margin_s, -1e-9)

    return margin


def _oldest(heard: int, packets: Iterable[PendingPacket], ticks: range) -> int:
    """The largest age in some ticks; -1: there are none."""
    there = [(packet.due_tick, packet.sent_tick) for packet in packets if not packet.corrupted]
    return max((t - max([heard, *(sent for due, sent in there if due <= t)]) for t in ticks), default=-1)


def _on_the_way(network: dict[str, Any]) -> dict[Link, list[PendingPacket]]:
    found: dict[Link, list[PendingPacket]] = {}
    for values in (*network["announced"], *network["pending"]):
        packet = PendingPacket(*values)
        found.setdefault((packet.src, packet.dst), []).append(packet)
    return found


def _known_ticks(scenario: Scenario, link: Link) -> int:
    """The least time from sending to arrival on a link [ticks]; 1 where a packet may overtake others."""
    config = scenario.netem_config
    if config.faults or config.changing or config.clocks or config.acoustic is not None:
        return 1
    condition = config.conditions.get(link, PERFECT)
    if condition.reorder or (condition.jitter_ns and condition.distribution != "uniform"):
        return 1
    return max(1, -(-(condition.delay_ns - condition.jitter_ns) // scenario.tick_ns))
