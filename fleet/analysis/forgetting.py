"""Protocols that forget a neighbour after a silence: how long that must be for the loss of their links."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from math import ceil, log

from agents.config import Law
from agents.plugins.laws import load
from fleet.scenario.scenario import Scenario
from netem.condition import Condition, Link
from world.errors import PluginError

PARAMETER = "forget_after_s"
RARE = 1e-5  # probability of such a silence that does no harm (docs/guide/protocols/average.md, High loss)


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
        if _one_by_one(condition):
            found[link] = max(condition.loss, found.get(link, 0.0))
    return found


def _one_by_one(condition: Condition) -> bool:
    return 0.0 < condition.loss < 1.0 and condition.loss_model is None and not condition.loss_correlation


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
