"""`fleet check` makes each law of the user once and gives it a sample: what fails is told with file and line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from failing_laws import module as module
from tool import invoke

from fleet.analysis.first_sample import try_laws
from fleet.errors import ScenarioError
from fleet.scenario.loading import load_scenario

LAW = """\
class Law:
    signals = ()
    def __init__(self, config):
        {made}
    def step(self, sample, command=None):
        {stepped}
"""
GOOD = "return (1.0, 0.0, 0.0), {}"


@pytest.mark.parametrize("kind", ["controller", "guidance", "tracking"])
@pytest.mark.parametrize(
    ("made", "stepped", "said"),
    [
        ("pass", GOOD, ""),
        ("config.nothing", GOOD, "AttributeError: 'AgentConfig' object has no attribute 'nothing' (FILE:4)"),
        ("pass", "return 1 / 0", "Law raised ZeroDivisionError: division by zero (FILE:6)"),
        ("pass", "return (1.0, 0.0), {}", "(1.0, 0.0): expected three numbers (FILE:5)"),
        ("pass", "return (float('nan'), 0.0, 0.0), {}", "every number must be finite (FILE:5)"),
        ("pass", "return None", "Law returned None: expected ("),
    ],
    ids=["good", "init", "step", "shape", "nan", "nothing"],
)  # fmt: skip
def test_a_law_is_made_and_answers(
    kind: str, made: str, stepped: str, said: str, module: Callable[[str], str], tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    name = module(LAW.format(made=made, stepped=stepped))
    result = invoke("check", "paper", "--set", f"{kind}={name}:Law")
    assert result.exit_code == (2 if said else 0), result.stderr
    assert said.replace("FILE", f"{name}.py") in result.stderr
    assert not said or result.stderr.startswith(f"fleet: paper.yaml: {kind} {name}:Law: agent 1, tick 0: Law ")


def test_each_law_is_made_once_and_each_failure_is_told(module: Callable[[str], str]) -> None:
    name = module("made = []\n" + LAW.format(made="made.append(config.id)", stepped=GOOD))
    broken = module(LAW.format(made="raise ValueError('no')", stepped=GOOD))
    two = f"{{2: {{controller: '{broken}:Law'}}, 3: {{guidance: '{broken}:Law', tracking: neurodynamic}}}}"
    scenario = load_scenario("paper", [f"controller={name}:Law", f"per_vehicle={two}", "on_controller_error=coast"])
    with pytest.raises(ScenarioError) as caught:
        try_laws(scenario)
    assert [problem.message.partition(" raised")[0] for problem in caught.value.problems] == [
        f"controller {broken}:Law: agent 2, tick 0: Law",
        f"guidance {broken}:Law: agent 3, tick 0: Law",
    ]
    assert __import__(name).made == [1]


def test_on_an_ideal_network_a_law_is_only_made(module: Callable[[str], str]) -> None:
    """There it would have heard its neighbours at its first sample."""
    name = module(LAW.format(made="pass", stepped="raise ValueError(len(sample.heard))"))
    try_laws(load_scenario("ideal", [f"controller={name}:Law"]))
