"""The parts of a scenario that may draw from the seed."""

from __future__ import annotations

import pytest
from small_scenario import small

from fleet.analysis.randomness import may_draw
from fleet.execution.whole_run import run
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.loading import load_scenario


@pytest.mark.parametrize("name", shipped_scenarios())
def test_where_nothing_may_draw_all_seeds_give_the_same_log(name: str) -> None:
    """In their first second. Where something is named, two seeds may give any logs, so none is made."""
    scenario = load_scenario(name, ["duration=1 s", "checks={}"])
    assert may_draw(scenario) or run(scenario, seed=1).digest == run(scenario, seed=2).digest


def test_some_of_what_ships_draws_and_some_does_not() -> None:
    """Otherwise the test above would compare no logs, or would name nothing."""
    assert may_draw(load_scenario("paper")) == []
    assert may_draw(load_scenario("rough-sea"))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ("initial={scatter: 1 m}", "initial scatter"),
        ("graph={shape: random}", "random graph"),
        ("sensors.position_noise=1 cm", "sensor noise"),
        ("navigation=tactical", "navigation"),
        ("sea.current={sigma: 5 5 0 cm/s}", "current"),
        ("network.links={'*': loss 40%}", "link conditions"),
        ("faults=[{at: 200 ms, partition: ring}]", "faults"),
    ],
)
def test_a_part_that_draws_is_named(change: str, part: str) -> None:
    calm = small("initial.scatter=0 m", "network.links={}", "faults=[]")
    assert may_draw(calm) == []
    assert part in may_draw(small("initial.scatter=0 m", "network.links={}", "faults=[]", change))
