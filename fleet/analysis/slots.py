"""How far the clocks of a fleet may differ until its time slots overlap.

| symbol | meaning | unit |
|---|---|---|
| S, A | slot; the longest airtime of a payload in it | s |
| c | time that sound takes across the formation | s |
| Ts | tick: a modem starts at the first whole tick at which its clock shows the start of its slot | s |
| D | duration of the run | s |

A slot is still clear of the one before if the clock of its vehicle is ahead of that of the other by less than

    d = S - A - c - Ts,

what is left of the guard. Two clocks that begin right and drift by no more than rho, one fast and one slow, differ by
2 rho D at the end. So a drift within +-d / (2 D) is covered. Other pairs of vehicles than those of neighbouring slots
have whole slots between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.acoustic import SIZES, extent_m
from netem.vehicle_clock import Clocks


class Slack(NamedTuple):
    """The time that slots leave for clocks that differ."""

    difference_s: float  # d
    drift: float  # drift of each clock, from the start to the end of the run [s/s]


def slack(scenario: Scenario) -> Slack | None:
    """The time that the slots of a scenario leave; None if it has no slots."""
    acoustic = scenario.acoustic
    if acoustic is None or acoustic.mac != "tdma":
        return None
    slot_ns, tick_ns = acoustic.slot_ticks * scenario.tick_ns, scenario.tick_ns
    airtime_ns = slot_ns - acoustic.guard_ns  # what a user's agent sends may be as long as that
    if all(control.agent is None for control in scenario.controls):
        size = SIZES[scenario.spec.network.payload]
        airtime_ns = max(acoustic.modem_of(i).airtime_ns(size) for i in range(1, scenario.vehicles + 1))
    crossing_ns = acoustic.delay_ns(extent_m(scenario.plans))
    left_s = max(0.0, (slot_ns - airtime_ns - crossing_ns - tick_ns) / 1e9)
    return Slack(left_s, left_s / (2.0 * scenario.duration_ns / 1e9))


def describe_slack(scenario: Scenario) -> Iterator[str]:
    """One line on the clocks that the slots bear; none without slots."""
    if (found := slack(scenario)) is not None:
        yield (
            f"clocks: time slots stay apart if clocks differ by less than {found.difference_s:.4g} s. Clocks that "
            f"begin right may drift by up to {found.drift * 1e6:.4g} ppm, fast or slow, in a run of "
            f"{scenario.duration_ns / 1e9:g} s"
        )


def slot_warnings(scenario: Scenario) -> Iterator[str]:
    """A warning if the clocks of a scenario differ by more than its slots bear."""
    found, clocks = slack(scenario), Clocks.that_differ(scenario.clocks, scenario.faults.world, scenario.tick_ns)
    if found is None or clocks is None:
        return
    order = range(1, scenario.vehicles + 1)
    changes = (tick for f in scenario.faults.world for tick in (f.begin, f.end) if f.kind == "clock")
    times = {0, scenario.ticks, *(tick for tick in changes if tick is not None and tick <= scenario.ticks)}
    # Only who is ahead of the vehicle of the slot before comes into its slot.
    worst = max(
        (clocks.ahead_ns(j, tick) - clocks.ahead_ns(i, tick), -tick, i, j)
        for tick in times
        for i, j in zip(order, [*order[1:], order[0]], strict=True)
    )
    if worst[0] / 1e9 > found.difference_s:
        ahead_ns, tick, i, j = worst
        at_s = -tick * scenario.tick_ns / 1e9
        yield (
            f"slots overlap: at {at_s:g} s the clock of vehicle {j} is {ahead_ns / 1e9:.4g} s ahead of that of vehicle "
            f"{i}, which has the slot before. The guard allows {found.difference_s:.4g} s. Use a longer slot, or "
            "better clocks"
        )
