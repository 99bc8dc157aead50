"""The cost of one vehicle's navigation in a tick: its instruments and its filter, without a fix."""

from __future__ import annotations

from itertools import pairwise
from statistics import median
from time import thread_time_ns

from fleet.scenario.loading import load_scenario
from fleet.scenario.sections.navigation import shipped_grades
from world.navigation.config import DeadReckoning
from world.navigation.navigator import Navigator, State

GOAL_US = 10.0
SECOND = 100  # ticks: that many have samples of every instrument among them, so a mean and no median is taken of them


def navigation_steps(seconds: int) -> dict[str, float]:
    """Microseconds of CPU time per tick by grade, with what the agent gets of it: the median over so many seconds."""
    return {name_of(grade): _step_us(grade, seconds) for grade in shipped_grades()}


def name_of(grade: str) -> str:
    """The name of the figure of a grade."""
    return f"navigation without a fix, {grade}"


def _step_us(grade: str, seconds: int) -> float:
    scenario = load_scenario("dead-reckoning", [f"navigation.grade={grade}"])
    config = scenario.controls[1].navigation  # of a vehicle without fixes
    assert isinstance(config, DeadReckoning)
    navigator = Navigator(config, scenario.seed, 2, scenario.tick_ns, _course(0))
    costs = []
    for second in range(seconds):
        way = [_course(second * SECOND + k) for k in range(SECOND + 1)]
        began = thread_time_ns()
        for before, after in pairwise(way):
            navigator.step(before, after, (0.0, 0.0, 0.0), (), 0.0)
            navigator.believed(after, ())
            navigator.covariance()
        costs.append((thread_time_ns() - began) / 1e3 / SECOND)
    return median(costs)


def _course(tick: int) -> State:
    """North at 0.7 m/s, 20 m deep."""
    return 0.007 * tick, 0.0, 20.0, 0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 0.0
