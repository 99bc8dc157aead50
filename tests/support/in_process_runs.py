"""Runs in this process that many tests compare with: each is made once in a session, by one of its workers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from shared import made_once

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.wiring import USUAL, Wiring
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario
from fleet.scenario.text.overrides import Override

Alone = Callable[..., Result]


def recorded(folder: Path, name: str, *overrides: Override | str, wiring: Wiring = USUAL, **options: Any) -> Result:
    """A run of a scenario in this process; `options` are further ones of `Options`."""
    how = Options(folder, quiet=True, **{"in_process": True, **options})
    return execute(load_scenario(name, overrides), how, wiring=wiring)


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Alone:
    """Gives the run of a scenario with overrides, passed or not. Nobody may write to its directory."""

    @cache
    def run(name: str, *overrides: str) -> Result:
        return made_once(tmp_path_factory, ("run", name, *overrides), lambda folder: recorded(folder, name, *overrides))

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
