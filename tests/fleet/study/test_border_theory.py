"""What theory says at a border: the same numbers as `fleet check`, and where loss makes what is heard too old."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.scenario.text.overrides import NET, Override
from fleet.study.borders import Borders, parse_along, prepare_borders, theory
from fleet.study.plan import Plan
from fleet.study.spec import BoundarySpec
from fleet.study.values import parse_axis


def test_the_rules_of_fleet_check_and_the_age_under_loss(tmp_path: Path) -> None:
    axes = (
        parse_axis("neighbours.extrapolate=neighbour, hold"),
        parse_axis("delay=0 s, 200 ms, 1 s"),
        parse_along("loss=0 %..100 %/4 %", 0.1),
    )
    plan = Plan("paper", (Override(NET, "* delay {delay} loss {loss}"),), axes)
    store, _ = prepare_borders(plan, BoundarySpec(), tmp_path / "study")
    found = theory(Borders(store))
    assert [one.shunting for one in found] == [(pytest.approx(8.13, abs=0.01), 10.0)] * 6
    assert [one.stable for one in found[:3]] == [True, True, False]  # it bears 0.25 s
    # K tau rho(A) = 2 x tau x 1.447 is 1 at tau = 0.3456 s, which is the delay and 0.1 s / (1 - p), less a tick.
    assert [one.reckoning for one in found] == [18, 9, 0, None, None, None]
