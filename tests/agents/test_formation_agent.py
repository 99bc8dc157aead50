"""The agent that ships within a whole agent of the user's."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from repository import ROOT

from agents.agent import Agent
from agents.api import FormationAgent, Motion, pack
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.logs.open_log import Log, open_log
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Delivery, Nav

SHORT = ["duration=3 s", "checks={}"]


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The class of the guide, in a module of its own."""
    text = (ROOT / "docs/guide/plugins.md").read_text()
    (code,) = [block for block in re.findall(r"```python\n(.*?)```", text, re.S) if "class Largest" in block]
    (tmp_path / "largest_of_all.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    return "largest_of_all:Largest"


def logged(tmp_path: Path, name: str, *changes: str) -> Log:
    scenario = load_scenario("paper", [*SHORT, *changes])
    return open_log(execute(scenario, Options(tmp_path / name, in_process=True, quiet=True)).directory)


def test_the_example_of_the_guide_keeps_the_formation_and_agrees(example: str, tmp_path: Path) -> None:
    """Its vehicles move as if the protocol were not there, to the last bit."""
    plain, with_it = logged(tmp_path, "plain"), logged(tmp_path, "with", f"agent={example}")
    for i in range(1, 5):
        assert np.array_equal(plain[f"uuv/{i}/state"].x, with_it[f"uuv/{i}/state"].x)
        assert set(with_it[f"uuv/{i}/control"].largest) <= {float(n) for n in range(1, 5)}
        assert with_it[f"uuv/{i}/control"].largest[-1] == 4.0


def nav(tick: int, x: float = 0.0) -> Nav:
    return Nav(0, tick, (x, 0.0, 3.0, 0.0, 0.0), (0.5, 0.0, 0.0, 0.0, 0.0))


@pytest.fixture
def config() -> Any:
    return load_scenario("paper", SHORT).agent_config(1)


def test_it_sends_and_reports_what_the_agent_does(config: Any) -> None:
    ours, agent = FormationAgent(config), Agent(config)
    assert ours.transmit(nav(0)) == agent.transmit(nav(0))
    tau, told = ours.decide(nav(0), [Delivery(2, 0, 0, 1, 0, pack("mine", 1))])
    decision = agent.decide(nav(0), [])
    assert tau == decision.tau
    assert list(told) == [signal.name for signal in ours.signals]
    flat = np.concatenate([np.atleast_1d(value) for value in told.values()])
    assert tuple(flat) == decision.telemetry
    assert told["payloads_rejected"] == 0.0  # what pack made is passed over


@pytest.mark.parametrize("kind", [tuple, list, np.array])
def test_a_course_is_gone_alone(config: Any, kind: Callable[[Any], Any]) -> None:
    """The consensus error is then the distance to the course; afterwards it is the formation's again."""
    agent = FormationAgent(config)
    _, told = agent.decide(nav(0), [], course=Motion(kind((10.0, -4.0, 5.0)), kind((0.5, 0.0, 0.0))))
    assert told["e_used"] == (-10.0, 4.0, -2.0)
    _, told = agent.decide(nav(1), [])
    assert told["e_used"] != (-10.0, 4.0, -2.0)


def test_it_steers_as_the_scenario_says(example: str) -> None:
    """Laws and their parameters hold beside a whole agent as without it."""
    laws = ["controller=bc", "profile=hardened", "guidance={K0: 1 2 3 1/s}", "tracking={k_u: 3 1/s}"]
    plain, beside = (
        load_scenario("paper", [*SHORT, *laws, *more]).agent_config(1) for more in ([], [f"agent={example}"])
    )
    assert (beside.guidance_law.name, beside.tracking.k_u, beside.guidance.K0) == ("fixed", 3.0, (1.0, 2.0, 3.0))
    assert beside == replace(plain, agent=beside.agent)
