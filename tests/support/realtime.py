"""What tests of runs on a wall clock share."""

from __future__ import annotations

from fleet.scenario.loading import load_scenario
from netem.wire.messages import Nav

PERIOD_NS = 10_000_000
SHORT = load_scenario("paper", ["duration=300 ms", "checks={}"])


def nav(tick: int, incarnation: int = 0) -> Nav:
    return Nav(incarnation, tick, (0.0,) * 5, (0.0,) * 5)
