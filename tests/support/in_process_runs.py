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
def alone(tmp_path_factory: pytest.TempPathFactory) -> Alone:
    """Gives the passed run of a scenario with overrides, in this process. Nobody may write to its directory."""
    made: dict[tuple[str, ...], Result] = {}

    def run(name: str, *overrides: str) -> Result:
        if (name, *overrides) not in made:
            out = tmp_path_factory.mktemp("alone")
            result = execute(load_scenario(name, overrides), Options(out, in_process=True, quiet=True))
            assert result.status is Status.PASS, (result.reason, result.lines, result.checks)
            made[name, *overrides] = result
        return made[name, *overrides]

    return run


def log_of(result: Result) -> Path:
    return result.directory / "run.mcap"
