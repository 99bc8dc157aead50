"""A whole space of faults: every member is made once, the smallest first, and the first failure is among those."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenario import SMALL, small
from study_engine import Here, Rows
from tool import invoke

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import CheckRow, Row
from fleet.addons.studies.small_space import KINDS, Space, run_all, space_of
from fleet.quantities import time_ns, vehicle_numbers
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario

SECOND = 10**9


@given(
    st.lists(st.sampled_from(KINDS), min_size=1, unique=True), st.integers(1, 3), st.integers(1, 3), st.integers(1, 2),
    st.integers(2, 5),
)  # fmt: skip
def test_a_space_is_as_large_as_it_says_and_has_no_member_twice(
    kinds: list[str], begins: int, lasts: int, most: int, vehicles: int
) -> None:
    space = Space(tuple(kinds), tuple(range(begins)), tuple(range(1, lasts + 1)), most)
    members = [json.dumps(member) for member in space.members(vehicles)]
    assert len(members) == len(set(members)) == space.size(vehicles)
    counts = [len(member) for member in space.members(vehicles)]
    assert counts == sorted(counts) and counts[0] == 0 and max(counts) <= most


@given(st.integers(2, 7))
def test_partitions_are_all_ways_to_cut_a_fleet_in_two(vehicles: int) -> None:
    faults = Space(("partition",), (0,), (1,), 1).faults(vehicles)
    sides = {
        frozenset(frozenset(map(int, side.split(","))) for side in fault["partition"].split(" / ")) for fault in faults
    }
    assert len(sides) == len(faults) == 2 ** (vehicles - 1) - 1
    assert all(frozenset.union(*each) == frozenset(range(1, vehicles + 1)) for each in sides)


def test_a_space_is_read() -> None:
    space = space_of("partition | kill,at 2s..4s/1s, for 500 ms , up to 2")
    assert space == Space(("partition", "kill"), (2 * SECOND, 3 * SECOND, 4 * SECOND), (SECOND // 2,), 2)
    times = [time_ns(fault["at"]) for fault in space.faults(3)]
    assert times == sorted(times)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected kinds of faults|cannot read"),
        ("kill, at 2s", "expected kinds of faults, when they begin, how long they last"),
        ("sink, at 2s, for 1s", "there is no kind 'sink' here: partition, kill"),
        ("kill, at noon, for 1s", r"at: expected a time, or FIRST\.\.LAST/STEP such as 2s\.\.10s/1s; got 'noon'"),
        ("kill, at 4s..2s/1s, for 1s", "at: expected at most 10000 times, upwards"),
        ("kill, at 0s..9s/1ns, for 1s", "at: expected at most 10000 times"),
        ("kill, at 2s, for 0s..1s/1s", "a fault lasts longer than 0 s"),
        ("kill, at 2s, for 1s, up to 5", "4 at most"),
        ("kill 1, at 2s, for 1s", "cannot read 'kill 1'"),
    ],
)
def test_what_is_no_space_is_told(text: str, words: str) -> None:
    with pytest.raises(StudyError, match=words):
        space_of(text)


class Judged(Here):
    """Makes up whether a scenario fails, and writes down what it was asked."""

    def __init__(self, fails: Callable[[Scenario], bool]) -> None:
        super().__init__()
        self._fails = fails
        self.asked: list[Scenario] = []

    def rows(self, task: Task) -> Rows:
        scenario = parse_scenario(task.text, task.name)
        self.asked.append(scenario)
        failed = self._fails(scenario)
        return [Row(key=task.key, point=task.point, seed=task.seed, status="check_failed" if failed else "pass",
                    passed=not failed, checks={"deaths": CheckRow(passed=not failed, value=1.0)})]  # fmt: skip


SPACE = space_of("mute|deaf, at 100ms..300ms/100ms, for 100ms..200ms/100ms, up to 2")


def test_all_are_made_when_none_fails() -> None:
    engine = Judged(lambda _: False)
    found = run_all(small(), SPACE, engine, lambda _: None)
    assert found.size == found.runs == len(engine.asked) == SPACE.size(small().vehicles)
    assert (found.scenario, found.without) == (None, 0)


def test_the_first_that_fails_has_the_fewest_faults_and_begins_first() -> None:
    def fails(scenario: Scenario) -> bool:
        return {1, 2} <= {i for fault in scenario.spec.faults for i in vehicle_numbers(fault.mute or fault.deaf)}

    engine = Judged(fails)
    found = run_all(small(), SPACE, engine, lambda _: None)
    assert found.check == "deaths" and found.scenario is not None
    first, second = found.scenario.spec.faults
    assert first.at <= second.at
    counts = [len(one.spec.faults) for one in engine.asked]
    assert all(a <= b for a, b in pairwise(counts))


def test_the_command_says_the_size_first_and_what_all_of_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(SMALL + "checks: {tumbled: waived, formation_error: {below: 1 km}}\n")
    asked = ("search", "small.yaml", "--workers", 1, "--all")
    done = invoke(*asked, "mute, at 100ms, for 100ms..200ms/100ms")
    assert done.exit_code == 0, done.output
    size = 1 + 2 * small().vehicles
    assert f"{size} runs: every set of up to 1 of {size - 1} faults; one took" in done.stderr
    assert f"all {size} were made; none fails a check" in done.stdout
    large = invoke(*asked, "partition|kill|mute|deaf, at 0s..500ms/1ms, for 1ms..500ms/1ms, up to 2")
    assert large.exit_code == 2 and "and 20,000 are made at most: --budget" in large.stderr
    failing = invoke(*asked, "mute, at 100ms, for 100ms", "--set", "checks={formation_error: {below: 1 mm}}")
    assert failing.exit_code == 1 and "No fault is needed" in failing.stdout, failing.output
    assert Path("small-least.yaml").exists()
    late = invoke(*asked, "mute, at 100s, for 100ms", "--force")
    assert late.exit_code == 2 and "a fault begins at 100 s, and the run ends at" in late.stderr
    both = invoke(*asked, "mute, at 0s, for 1s", "--nemesis", "--force")
    assert both.exit_code == 2 and "--all makes every fault of a space" in both.stderr
