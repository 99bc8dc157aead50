"""The mistakes of a study's points: each is reported once, with the points that have it."""

from __future__ import annotations

import pytest

from fleet.errors import Problem, ScenarioError
from fleet.scenario.text.overrides import NET, SET, Override
from fleet.study.load_points import load_points
from fleet.study.plan import Plan
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


def test_two_mistakes_stay_two() -> None:
    found = mistakes("loss=0 %, 5 %", "delya=1 s, 2 s", change=Override(NET, "* loss {loss}"))
    assert [problem.file for problem in found] == ["--vary delya=1 s"]
    assert len(mistakes("lss=0 %, 5 %", "delya=1 s, 2 s")) == 2
