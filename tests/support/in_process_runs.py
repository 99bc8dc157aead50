"""Runs in this process that many tests compare with: each is made once in a session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario

Alone = Callable[..., Result]


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Alone:
    """Gives the run of a scenario with overrides, passed or not. Nobody may write to its directory."""
    known: dict[tuple[str, ...], Result] = {}

    def run(name: str, *overrides: str) -> Result:
        if (name, *overrides) not in known:
            out = tmp_path_factory.mktemp("made")
            scenario = load_scenario(name, overrides)
            known[name, *overrides] = execute(scenario, Options(out, in_process=True, quiet=True))
        return known[name, *overrides]

    return run


@pytest.fixture(scope="session")
def alone(made: Alone) -> Alone:
    """The same of a run that has to pass."""

    def run(name: str, *overrides: str) -> Result:
        result = made(name, *overrides)
        assert result.status is Status.PASS, (result.reason, result.lines, result.checks)
        return result

    return run


def log_of(result: Result) -> Path:
    return result.directory / "run.mcap"
