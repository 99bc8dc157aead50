"""Moored vehicles stay where they begin, whatever their agents and the sea do."""

from __future__ import annotations

from dataclasses import replace

import pytest

from agents.formation_agent import FormationAgent
from fleet.errors import ScenarioError
from fleet.execution.stepped_run import Run
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from netem.wire.messages import Nav

MOORED = """
title: moored
moored: true
vehicles: 3
duration: 5 s
graph: {shape: path}
agent: "fleet.protocols.average:ExactAverage"
network: {period: 200 ms, links: {"*": delay 100ms}}
"""


def moored(*changes: str) -> Scenario:
    return parse_scenario(MOORED, "m.yaml", changes)


def test_what_may_be_left_out() -> None:
    """A line of places 10 m apart, at rest, and a tick for each round."""
    s = moored()
    assert s.tick_ns == s.spec.network.period and s.round_ticks == 1
    assert [eta[:3] for eta, _ in s.initial] == [(0.0, y, 10.0) for y in (0.0, -10.0, -20.0)]
    assert moored("tick=10 ms").round_ticks == 20
    assert parse_scenario(s.to_yaml(), "m.yaml").spec == s.spec


@pytest.mark.parametrize(
    "changes",
    [
        (),
        ("initial={scatter: 3 m, surge: 1 m/s, around: origin}", "reference={start: 0 0 5 m, velocity: 1 0 0 m/s}"),
        ("sea={disturbance: paper, current: 0.5 0 0 m/s}", "faults=[{at: 1 s, wrench: {force: 90 0 0 N}}]"),
    ],
)
def test_nothing_moves(changes: tuple[str, ...]) -> None:
    s = moored(*changes)
    with Run(s) as run:
        begin = {i: one.eta for i, one in run.state.vehicles.items()}
        run.step("4 s")
        assert {i: (one.eta, one.nu) for i, one in run.state.vehicles.items()} == {
            i: (eta, (0.0,) * 5) for i, eta in begin.items()
        }


def test_the_agent_that_ships_neither_sends_nor_steers_there() -> None:
    agent, nav = FormationAgent(moored().agent_config(1)), Nav(0, 0, (0.0,) * 5, (0.0,) * 5)
    assert (agent.signals, agent.transmit(nav)) == ((), ())
    assert agent.decide(nav, []) == ((0.0, 0.0, 0.0), {})
    assert FormationAgent(replace(moored().agent_config(1), moored=False)).transmit(nav) != ()


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("agent=null", "moored"),
        ("navigation={gps: {}}", "navigation"),
        ("vehicle.plant=remus100", "vehicle.plant"),
    ],
)
def test_a_mistake_is_at_its_key(change: str, key: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        moored(change)
    assert key in [problem.key for problem in caught.value.problems]
