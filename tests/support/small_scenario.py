"""A small scenario to change one thing of, and what is wrong with it then."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import strategies as st

from fleet.errors import ScenarioError
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario

SMALL = """\
title: Three vehicles
vehicles: 3
duration: 1 s
reference: {start: 0 0 5 m, velocity: 0.5 0 0 m/s}
formation: {shape: grid, spacing: 5 m}
graph: {shape: path}
initial: {scatter: 1 m}
network: {period: 50 ms}
"""


def small(*overrides: str) -> Scenario:
    return parse_scenario(SMALL, "small.yaml", overrides)


def places(s: Scenario) -> tuple[tuple[float, ...], ...]:
    """The formation at the start."""
    return tuple(plan.start for plan in s.plans)


def read_back(s: Scenario) -> Scenario:
    """The scenario as it is printed and read again: it is the same, and so is all that it compiles to."""
    again = parse_scenario(s.to_yaml(), "again.yaml")
    assert again == s and again.to_yaml() == s.to_yaml()
    assert (again.world_config, again.netem_config) == (s.world_config, s.netem_config)
    assert [again.agent_config(i) for i in range(1, s.vehicles + 1)] == [
        s.agent_config(i) for i in range(1, s.vehicles + 1)
    ]
    return again


def accepted(*overrides: str) -> bool:
    """Whether the small scenario may be changed so: then it reads back. Otherwise a mistake says why."""
    try:
        s = small(*overrides)
    except ScenarioError as error:
        assert error.problems and str(error)  # noqa: PT017 - most are errors, all must be ours
        return False
    read_back(s)
    return True


@pytest.fixture
def small_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The small scenario as a file in this folder."""
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(SMALL, "utf-8")
    return "small.yaml"


def only_problem(*overrides: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        small(*overrides)
    assert len(caught.value.problems) == 1, str(caught.value)
    return str(caught.value)


WILD = st.one_of(
    st.text(max_size=20),
    st.sampled_from(
        ["3", "3 m", "[1, 2]", "{}", "{a: 1}", "[]", "null", ".nan", "-1", "1e400", "true", "0 0 0 m", "5 s", "*"]
    ),
    st.sampled_from(
        ["{position: 1}", "[{}]", "{scatter: {}}", "{1->2: {}}", "{edges: 3}", "{links: []}", "[[[]]]", "999"]
    ),
)
