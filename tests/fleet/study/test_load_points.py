"""The mistakes of a study's points: each is reported once, with the points that have it."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.errors import Problem, ScenarioError
from fleet.scenario.text.overrides import NET, SET, Override
from fleet.study.plan import Plan
from fleet.study.sweep import load_points
from fleet.study.values import parse_axis

SHORT = Override(SET, "duration=2 s")


def mistakes(*axes: str, change: Override = SHORT) -> tuple[Problem, ...]:
    plan = Plan("rough-sea", (change,), tuple(map(parse_axis, axes)))
    with pytest.raises(ScenarioError) as caught:
        load_points(plan)
    return caught.value.problems


@pytest.mark.parametrize("key", ["loss", "network.loss", "network.link.*.loss"])
def test_a_wrong_key_is_reported_once_with_the_remedy(key: str) -> None:
    (problem,) = mistakes(f"{key}=0 %..95 %/5 %")
    assert "(in" not in problem.message  # every point has it
    assert "network.links.*.loss" in problem.hint
    assert "--net '* loss {loss}'" in problem.hint


def test_a_wrong_value_of_some_points_is_reported_once() -> None:
    (problem,) = mistakes("network.period=0 %, 5 %, 100 ms")
    assert problem.message.endswith("(in 2 of 3 points, first network.period=0 %)")


def test_a_mistake_in_the_file_is_reported_once_whatever_values_are_like_its_words(tmp_path: Path) -> None:
    """Neither a value in the name of the file nor one that the message has beside others makes two of it."""
    file = tmp_path / "bad1.yaml"
    file.write_text("vehicles: 3\nnetwork: {period: 15 ms}\n", "utf-8")
    plan = Plan(str(file), (Override(NET, "* loss {loss}%"),), (parse_axis("loss=0, 1, 10, 15"),))
    with pytest.raises(ScenarioError) as caught:
        load_points(plan)
    said = [problem.message for problem in caught.value.problems]
    assert len(said) == len(set(said)) and not any("points" in message for message in said)
    assert "network.period: 15 ms is not a whole number of ticks of 10 ms" in said


def test_wrong_numbers_are_one_mistake_and_two_of_one_point_stay_two() -> None:
    (problem,) = mistakes("network.links.*.loss=0 %..150 %/10 %")
    assert problem.message.endswith("(in 5 of 16 points, first network.links.*.loss=110 %)")
    killed = Override(SET, "faults=[{at: 1 s, kill: 8}, {at: 2 s, kill: 9}]")
    assert len(mistakes("network.links.*.loss=0 %, 10 %", change=killed)) == 2


def test_two_mistakes_stay_two() -> None:
    found = mistakes("loss=0 %, 5 %", "delya=1 s, 2 s", change=Override(NET, "* loss {loss}"))
    assert [problem.file for problem in found] == ["--vary delya=1 s"]
    assert len(mistakes("lss=0 %, 5 %", "delya=1 s, 2 s")) == 2
