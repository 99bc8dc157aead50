"""Which runs a study has, in which order, and what is wrong with a plan."""

from __future__ import annotations

import re
from typing import Any

import pytest
from refusals import check_refusals

from fleet.addons.studies.plan import Plan, parse_seeds, plan_of
from fleet.addons.studies.spec import StudySpec
from fleet.addons.studies.sweep import load_points
from fleet.addons.studies.values import parse_axis
from fleet.errors import ScenarioError
from fleet.scenario.text.overrides import FAULT, NET, SET, Override

LOSS, DELAY = parse_axis("loss=0 %,30 %"), parse_axis("delay=100 ms,1 s")


def test_every_value_with_every_other() -> None:
    plan = Plan("paper", (Override(NET, "* loss {loss} delay {delay}"),), (LOSS, DELAY), seeds=(7, 3))
    assert len(plan) == 8
    shown = ["loss=0 %, delay=100 ms", "loss=0 %, delay=1 s", "loss=30 %, delay=100 ms", "loss=30 %, delay=1 s"]
    assert [point.shown for point in plan.points] == shown
    assert plan.points[1].changes == (Override(NET, "* loss 0 % delay 1 s"),)


def test_a_key_that_fills_no_template_is_one_of_the_scenario() -> None:
    axes = (parse_axis("controller=nboc,bc"), parse_axis("who=2,3"))
    plan = Plan("paper", (Override(FAULT, "at 3s kill {who}"),), axes)
    typed = Override(SET, "controller=bc", "--vary controller=bc")
    assert plan.points[3].changes == (Override(FAULT, "at 3s kill 3"), typed)


def test_zipped_values_go_together() -> None:
    plan = Plan("paper", (Override(NET, "* loss {loss} delay {delay}"),), (LOSS, DELAY), zipped=True)
    assert [point.shown for point in plan.points] == ["loss=0 %, delay=100 ms", "loss=30 %, delay=1 s"]


def test_drawn_values_are_drawn_together_and_crossed_with_the_others() -> None:
    axes = (parse_axis("a=0..10 latin 5"), parse_axis("c=x,y"), parse_axis("b=1..100 latin log 5"))
    set_all = (Override(SET, "k={a}{b}{c}"),)
    plan = Plan("paper", set_all, axes)
    assert len(plan.points) == 10
    assert list(plan.points[0].values) == ["a", "c", "b"]
    numbers = [point.values["a"].number for point in plan.points[::2]]
    assert sorted(int(number // 2) for number in numbers if number is not None) == [0, 1, 2, 3, 4]  # one in each fifth
    assert plan.points == Plan("paper", set_all, axes).points
    assert plan.points != Plan("paper", set_all, axes, draw=2).points


@pytest.mark.parametrize(
    ("text", "seeds"), [("3", (1, 2, 3)), ("5..7", (5, 6, 7)), ("3,7,3", (3, 7)), ("0..0", (0,)), ("1", (1,))]
)
def test_seeds(text: str, seeds: tuple[int, ...]) -> None:
    assert parse_seeds(text) == seeds


def test_what_is_no_plan() -> None:
    cases = [
        ((LOSS, LOSS), (), False),
        ((parse_axis("seed=1,2"),), (), False),
        ((parse_axis("a=0..1 lin 20000"), parse_axis("b=0..1 lin 20000")), (), False),
        ((parse_axis("a=0..1 lin 400"), parse_axis("b=0..1 lin 400")), (), False),
        ((parse_axis("wall_s=1,2"),), ("k={wall_s}",), False),
        ((LOSS,), ("k={los}",), False),
        ((LOSS, parse_axis("c=a,b,c")), (), True),
        ((parse_axis("a=0..1 latin 5"), parse_axis("b=0..1 latin 6")), (), False),
        ((parse_axis("a=0..1 latin 5"), parse_axis("b=0..1 random 5")), (), False),
    ]

    def make(axes: tuple[Any, ...], changes: tuple[str, ...], zipped: bool) -> None:
        Plan("paper", tuple(Override(SET, text) for text in changes), axes, zipped)

    check_refusals("study/plans", make, cases)


def test_what_is_drawn_twice_is_one_point() -> None:
    """Of twenty values rounded to three steps at most three can differ, and no two points are the same."""
    plan = Plan("paper", (), (parse_axis("network.period=100 ms..300 ms/100 ms random 20"),))
    texts = [point.values["network.period"].text for point in plan.points]
    assert sorted(texts) == ["100 ms", "200 ms", "300 ms"]


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("x", "--net '* loss {x}'"),
        ("vehicels", 'did you mean "vehicles"?'),
        ("networ.period", 'did you mean "network"'),
    ],
)
def test_a_key_that_nothing_uses_is_told_without_the_list_of_all_keys(key: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(words)) as told:
        load_points(plan_of(StudySpec("paper", vary={key: "1,2"})))
    assert len(str(told.value)) < 200
    if key == "x":
        assert len(load_points(plan_of(StudySpec("paper", vary={key: "1,2"}, net=["* loss {x}%"])))) == 2
