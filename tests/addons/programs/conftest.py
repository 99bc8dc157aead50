"""What the tests of programs share."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent

import pytest
from own_program import RunProgram, scenario

import fleet
from fleet.result.result import Result


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunProgram:
    """Writes a program into the current folder, and runs it as every agent of a moored fleet."""
    monkeypatch.chdir(tmp_path)

    def made(text: str, arguments: str = '["{id}"]', vehicles: int = 2, signal: str = "v", **changes: str) -> Result:
        (tmp_path / "program.py").write_text(dedent(text))
        (tmp_path / "own.yaml").write_text(scenario(arguments, vehicles, signal, **changes))
        return fleet.run("own.yaml", out=tmp_path / "runs")

    return made
