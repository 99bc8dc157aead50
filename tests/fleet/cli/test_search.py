"""`fleet search` as people type it."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from small_scenario import SMALL
from study_engine import Here

from fleet.cli.main import cli
from fleet.execution.judged import run

RANDOM = """\
nemesis: {every: 400 ms, for: 300 ms, pick: [mute, deaf, {wrench: {vehicles: 1, force: 400 0 0 N}}]}
checks: {formation_error: {below: 4.6 m, after: 800 ms}, tumbled: waived}
"""
CALM = "checks.formation_error.below=99 m"


@pytest.fixture(autouse=True)
def random_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.study.local_engine.engine_of", lambda *_: nullcontext(Here()))
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(SMALL + RANDOM, "utf-8")


def call(*args: str) -> Result:
    return CliRunner().invoke(cli, ["search", *args])


def test_the_first_seed_that_fails_is_made_less() -> None:
    result = call("small.yaml", "--budget", "4")
    assert result.exit_code == 1, result.output
    assert "seed 2 fails formation_error, the first one from 1 on" in result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("small fails formation_error with ")
    assert lines[-1] == "small-least.yaml"
    assert not run("small-least.yaml").passed


def test_as_a_document() -> None:
    again = call("small.yaml", "--budget", "4", "--json")
    document = json.loads(again.stdout)
    assert (document["seed"], document["most_failures"]) == (2, None)
    assert document["least"]["file"] == "small-least.yaml"
    assert document["least"]["before"]["faults"] >= document["least"]["after"]["faults"]


def test_none_that_fails_is_said_with_a_bound() -> None:
    result = call("small.yaml", "--budget", "3", "--set", CALM)
    assert result.exit_code == 0, result.output
    assert result.stdout.split() == (
        [
            "none",
            "of",
            "3",
            "runs",
            "fails",
            "a",
            "check:",
            "at",
            "most",
            "63",
            "%",
            "of",
            "such",
            "runs",
            "do,",
            "with",
            "95",
            "%",
            "confidence",
        ]
    )
    document = json.loads(call("small.yaml", "--budget", "3", "--set", CALM, "--json").stdout)
    assert (document["seed"], document["runs"], document["least"]) == (None, 3, None)
    assert document["most_failures"] == pytest.approx(0.6316, abs=1e-4)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["paper"], "paper has no nemesis that another seed would change: --nemesis adds one"),
        (["small.yaml", "--nemesis"], "small has a nemesis: change it"),
        (["small.yaml", "--check", "ledger"], "small has no check ledger"),
        (["small.yaml", "--budget", "0"], "expected a number of runs such as 200, or a time such as '10 min', got '0'"),
        (["small.yaml", "--budget", "5 quarks"], "expected a number of runs"),
        (["small.yaml", "--out", "nowhere/x.yaml"], "there is no folder nowhere"),
        (["small.yaml", "--budget", "1 ns"], "no run came to its end"),
        (["loss-delay"], "loss-delay is a study, not a scenario: fleet sweep loss-delay runs it"),
    ],
)
def test_mistakes_are_usage(args: list[str], message: str) -> None:
    result = call(*args)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not list(Path().glob("*-least.yaml"))
