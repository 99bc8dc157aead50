"""The cost of one vehicle's localisation in a tick in which a range comes."""

from __future__ import annotations

from statistics import median
from time import thread_time_ns

from agents.localization import payload
from agents.localization.localizer import Localizer
from agents.payload import StateMessage
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Delivery, Nav

METHODS = ("aid", "consistent")
SECOND = 50  # ticks, between two ranges


def localization_steps(ranges: int) -> dict[str, float]:
    """Microseconds of CPU time by method: the median over so many ticks with a range from an aid 30 m away."""
    return {f"localisation with a range, {method}": _step_us(method, ranges) for method in METHODS}


def _step_us(method: str, ranges: int) -> float:
    scenario = load_scenario("navigation-aid", [f"agent.localization={method}"])
    localizer = Localizer(scenario.agent_config(2))
    costs = []
    for tick in range(ranges * SECOND):
        nav = _nav(tick)
        if tick % SECOND:
            localizer.absorb(nav, ())
            continue
        deliveries = (_range(tick),)
        began = thread_time_ns()
        localizer.absorb(nav, deliveries)
        costs.append((thread_time_ns() - began) / 1e3)
    assert localizer.used, "no range was used, so none was measured"
    return median(costs)


def _nav(tick: int) -> Nav:
    """North at 0.7 m/s, 20 m deep, less sure of its place with every metre."""
    north = 0.014 * tick
    variance = 1.0 + (0.03 * north) ** 2
    belief = (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.01, 0.0, 0.001)
    return Nav(0, tick, (north, 0.0, 20.0, 0.0, 0.0), (0.7, 0.0, 0.0, 0.0, 0.0), (), None, belief)


def _range(tick: int) -> Delivery:
    """From an aid abeam."""
    state = StateMessage(1, tick, (0.014 * tick, 30.0, 20.0), (0.7, 0.0, 0.0))
    data = payload.encode(payload.LocatedMessage(state, (0.1, 0.0, 0.1), True))
    return Delivery(tick, tick, 1, tick, 0, data, 30.0, 0.5, tick)
