"""The least that breaks a run: what is left fails by itself, and nothing of it can be left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenario import small
from study_engine import Here, Rows

from agents.config import Law
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import CheckRow, Row
from fleet.addons.studies.shrink import Shrinker, are_told, ddmin, number_places
from fleet.errors import ScenarioError
from fleet.execution.whole_run import run_loaded
from fleet.quantities import vehicle_numbers
from fleet.scenario.faults.partitions import partition
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from netem.link_selector import parse_selector

FAULTS = (
    "faults=["
    "{id: noise, at: 100 ms, for: 200 ms, noise: {vehicles: 2, position_noise: 1 cm}},"
    "{id: mute, at: 200 ms, for: 300 ms, mute: 3},"
    "{id: push, at: 300 ms, for: 400 ms, wrench: {vehicles: 1, force: 400 0 0 N}},"
    "{id: loss, at: 500 ms, for: 100 ms, link: {'*': loss 40%}},"
    "{id: deaf, at: 600 ms, for: 100 ms, deaf: 2}]"
)
CHECK = "checks={formation_error: {below: 4.6 m, after: 800 ms}}"


def shrinker(*overrides: str, engine: Here | None = None) -> Shrinker:
    return Shrinker(small(*overrides), engine or Here(), lambda doing, runs: None)


def test_what_is_not_needed_goes_and_what_is_left_fails() -> None:
    found = shrinker(FAULTS, CHECK).shrink()
    assert found.check == "formation_error"
    (fault,) = found.scenario.spec.faults
    assert fault.id == "push"
    assert 0.0 < fault.wrench.force[0] < 400.0
    assert found.scenario.vehicles == 2
    assert found.steps[0] == "1 of 5 faults are needed"
    assert found.scenario.duration_ns > 800_000_000  # a run that only ended too early does not count
    assert not run_loaded(found.scenario).passed


def test_a_check_without_anything_to_judge_does_not_count() -> None:
    """Without a fault there is no recovery that could be too slow. And what is left is the same, whoever made the runs,
    in whatever order."""
    every = "checks={recovery_time: [{fault: every, within: 1 mm, below: 100 ms, error: formation}], tumbled: waived}"
    faults = "faults=[{at: 200 ms, for: 300 ms, mute: 3}, {at: 500 ms, for: 100 ms, link: {'*': loss 40%}}]"
    found, again = (
        shrinker(faults, every, engine=one).shrink("recovery_time") for one in (Here(), Here(backwards=True))
    )
    assert len(found.scenario.spec.faults) == 1
    assert again.scenario == found.scenario


class Judged(Here):
    """Makes up whether the check `deaths` fails in a scenario, in place of running it. An invalid one fails to run."""

    def __init__(self, fails: Callable[[Scenario], bool]) -> None:
        super().__init__()
        self._fails = fails

    def rows(self, task: Task) -> Rows:
        try:
            failed = self._fails(parse_scenario(task.text, task.name))
        except ScenarioError:
            return [Row(key=task.key, seed=task.seed, status="failed")]
        check = CheckRow(passed=not failed, value=1.0)
        return [Row(key=task.key, seed=task.seed, status="check_failed" if failed else "pass", passed=not failed,
                    checks={"deaths": check})]  # fmt: skip


def least(fault: str, fails: Callable[[Scenario], bool], *changes: str) -> Any:
    """What is left of a fault in a fleet of six."""
    fleet = ("vehicles=6", "graph={shape: complete}", f"faults=[{{at: 0 s, {fault}}}]", *changes)
    found = shrinker(*fleet, engine=Judged(fails)).shrink()
    (left,) = found.scenario.spec.faults
    return found, left


@pytest.mark.parametrize(("kind", "needed"), [("kill", {1}), ("kill", {2, 5}), ("off", {3}), ("mute", {1, 4, 6})])
def test_exactly_the_vehicles_that_a_failure_needs_are_left(kind: str, needed: set[int]) -> None:
    def fails(s: Scenario) -> bool:
        return any(needed <= {*vehicle_numbers(getattr(fault, kind))} for fault in s.spec.faults)

    found, left = least(f"{kind}: 1-6", fails)
    assert vehicle_numbers(getattr(left, kind)) == sorted(needed)
    assert found.scenario.vehicles == max(needed)


def test_a_fleet_that_is_too_small_to_pass_is_no_smaller_failure() -> None:
    """It was "no fault is needed, 1 of 4 vehicles": four cannot be counted in a fleet of one."""

    def fails(s: Scenario) -> bool:
        return s.vehicles < 3 or any(2 in vehicle_numbers(fault.mute) for fault in s.spec.faults)

    found, left = least("mute: 1-6", fails)
    assert vehicle_numbers(left.mute) == [2] and found.scenario.vehicles == 3


@pytest.mark.parametrize(
    ("parameters", "told"),
    [({}, False), ({"members": 6}, True), ({"ring": [1, 2, 3, 4, 5, 6]}, True), ({"a": 6.0}, False)],
)
def test_a_law_that_knows_how_many_there_are_keeps_all(parameters: dict[str, Any], told: bool) -> None:
    scenario = small("vehicles=6", "graph={shape: complete}")
    assert not are_told(scenario)
    law = Law("mine:Law", parameters)
    scenario.controls = tuple(replace(control, controller=law) for control in scenario.controls)
    assert are_told(scenario) == told


@pytest.mark.parametrize("needed", [{2}, {1, 3}])
def test_also_of_a_fault_with_values_that_names_none(needed: set[int]) -> None:
    def fails(s: Scenario) -> bool:
        every = [*range(1, s.vehicles + 1)]
        return any(needed <= {*(fault.kind.vehicles(fault.values) or every)} for fault in s.spec.faults)

    _, left = least("noise: {position_noise: 1 cm}", fails, "name=x")
    assert {*(left.kind.vehicles(left.values) or range(1, 7))} >= needed
    assert len(left.kind.vehicles(left.values) or needed) == len(needed)


@pytest.mark.parametrize("text", ["1,2 / 3,4 / 5,6", "halves", "majority", "1,2 / 3"])
@pytest.mark.parametrize("link", [(1, 4), (3, 1)])
def test_a_partition_cuts_off_no_more_vehicles_than_a_failure_needs(text: str, link: tuple[int, int]) -> None:
    def fails(s: Scenario) -> bool:
        cuts = [partition(str(f.partition), s.vehicles, s.spec.seed, f.id or "f1") for f in s.spec.faults]
        return any(link in cut for cut in cuts)

    if link not in partition(text, 6, 1, "f1"):
        return
    found, left = least(f'partition: "{text}"', fails)
    assert left.partition in (f"isolate:{i}" for i in link)
    assert found.scenario.vehicles == max(link)


@pytest.mark.parametrize("text", ["*", "*->3", "2<->3"])
@pytest.mark.parametrize("fault", ["down: '{}'", "hold: '{}'", "duplicate: {{links: '{}', after: 1 s}}",
                                   "link: {{'{}': loss 30%}}"])  # fmt: skip
def test_a_fault_of_links_is_left_on_the_one_that_a_failure_needs(fault: str, text: str) -> None:
    def selectors(s: Scenario) -> list[str]:
        values = [getattr(each, each.kind.name) for each in s.spec.faults]
        return [one for value in values for one in ([value] if isinstance(value, str)
                else [*value] if isinstance(value, dict) else [value.links])]  # fmt: skip

    def fails(s: Scenario) -> bool:
        return any(parse_selector(one).matches((2, 3)) for one in selectors(s))

    found, _ = least(fault.format(text), fails)
    assert selectors(found.scenario) == ["2->3"]
    assert found.scenario.vehicles == 3


def test_what_became_of_a_list_is_said() -> None:
    found, _ = least("kill: '1,2,4'", lambda s: bool(s.spec.faults) and "2" in str(s.spec.faults[0].kill))
    assert found.steps[:1] == ["fault 1 is kill 2 instead of 1,2,4"]


def test_only_what_makes_a_fault_stronger_is_made_less() -> None:
    assert number_places({"*": "delay 300ms 20ms loss 60% rate 1kbit", "1->2": "loss gemodel 1% 10%"}) == [0, 1, 2]
    assert number_places({"vehicles": "2", "position_noise": "1 cm"}) == [0]


def test_the_runs_may_be_used_up() -> None:
    engine = Here()
    found = shrinker(FAULTS, CHECK, engine=engine).shrink(most_runs=4)
    assert len(engine.tasks) <= 4
    assert not run_loaded(found.scenario).passed


class Asked:
    """Fails if all of some items are there; counts what it is asked."""

    def __init__(self, needed: set[int]) -> None:
        self.needed, self.count = needed, 0

    def __call__(self, parts: list[list[int]]) -> list[bool]:
        self.count += len(parts)
        return [self.needed <= set(part) for part in parts]


@given(st.integers(0, 60).flatmap(lambda n: st.tuples(st.just(n), st.sets(st.integers(0, max(0, n - 1)), max_size=6))))
def test_exactly_what_is_needed_is_left(case: tuple[int, set[int]]) -> None:
    n, needed = case
    if n == 0:
        needed = set()
    assert ddmin(range(n), Asked(needed)) == sorted(needed)


@given(st.integers(1, 40), st.integers(1, 5), st.integers(0, 999))
def test_no_item_of_the_rest_can_be_left_out(n: int, least: int, seed: int) -> None:
    """Whatever fails: here a part whose sum is large enough, or that has an odd item beside an even one."""

    def fails(parts: list[list[int]]) -> list[bool]:
        return [sum((item * seed) % 7 for item in part) >= least for part in parts]

    if not fails([list(range(n))])[0]:
        return
    left = ddmin(range(n), fails)
    assert fails([left])[0]
    assert not any(fails([left[:k] + left[k + 1 :] for k in range(len(left))]))


def test_two_of_forty_are_found_in_few_tests() -> None:
    asked = Asked({7, 31})
    assert ddmin(range(40), asked) == [7, 31]
    assert asked.count < 80
