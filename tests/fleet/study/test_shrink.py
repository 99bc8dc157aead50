"""The least that breaks a run: what is left fails by itself, and nothing of it can be left out."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from small_scenario import small
from study_engine import Here

from fleet.execution.stepped_run import judged
from fleet.study.shrink import Shrinker, ddmin, number_places

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
    assert not judged(found.scenario).passed


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


def test_only_what_makes_a_fault_stronger_is_made_less() -> None:
    assert number_places({"*": "delay 300ms 20ms loss 60% rate 1kbit", "1->2": "loss gemodel 1% 10%"}) == [0, 1, 2]
    assert number_places({"vehicles": "2", "position_noise": "1 cm"}) == [0]


def test_the_runs_may_be_used_up() -> None:
    engine = Here()
    found = shrinker(FAULTS, CHECK, engine=engine).shrink(most_runs=4)
    assert len(engine.tasks) <= 4
    assert not judged(found.scenario).passed


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
