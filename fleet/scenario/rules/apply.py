"""The rules that the keys of a scenario must fulfil together.

Each rule looks at a few keys and reports what does not fit. A rule stops when it reads a value that is wrong by itself
(`UnknownValueError`): that mistake is reported already. The other rules go on.
"""

from __future__ import annotations

from collections.abc import Callable

from fleet.scenario.parts import Parts, UnknownValueError
from fleet.scenario.rules import (
    checks,
    faults,
    laws,
    link_conditions,
    motion,
    navigation,
    network,
    plants,
    timing,
)
from fleet.scenario.rules.report import Report


def check(parts: Parts, report: Report) -> None:
    """Report every mistake that a rule finds."""
    for rule in RULES:
        try:
            rule(parts, report)
        except UnknownValueError:
            continue


RULES: tuple[Callable[[Parts, Report], None], ...] = (
    timing.duration,
    timing.network_period,
    timing.policies,
    timing.snapshot,
    timing.qp_period,
    motion.reference,
    motion.formation,
    motion.initial,
    motion.graph_form,
    motion.edges,
    motion.followers,
    motion.knowledge,
    network.links,
    link_conditions.link_conditions,
    network.acoustic,
    network.talking,
    laws.per_vehicle,
    navigation.navigation,
    faults.faults,
    faults.nemesis,
    checks.checks,
    checks.max_age,
    checks.connected,
    checks.recovery_time,
    laws.laws,
    plants.plants,
    navigation.localization,
    navigation.faults,
    checks.signal,
    checks.python,
    checks.names,
    laws.effective,
    plants.rolls,
    laws.keep_apart,
    laws.vehicles,
    laws.velocity_bounds,
    laws.gain_bounds,
    laws.cosine_guard,
)
