"""Commands for a log that nobody named: they take the newest run."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from in_process_runs import Alone
from marks import slow
from tool import invoke


@pytest.fixture
def two(alone: Alone, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Two runs below `runs`; `latest` leads to the second."""
    result = alone("paper", "duration=1 s", "checks={}")
    monkeypatch.chdir(tmp_path)
    paths = Path("runs/paper-1-20261120-120000"), Path("runs/paper-1-20261121-120000")
    for path in paths:
        shutil.copytree(result.directory, path)
    os.symlink(paths[1].name, "runs/latest")
    return paths


LOG_COMMANDS = [
    ["info"],
    ["verify", "-q"],
    ["export", "--scenario"],
    ["plot", "--what", "error"],
    *slow(["report"]),
    ["export", "--csv", "tables", "--topics", "faults"],
    ["whatif", "--agent", "1"],
    ["recover"],
]


@pytest.mark.parametrize("arguments", LOG_COMMANDS)
def test_without_a_log_the_newest_run_is_taken(arguments: list[str], two: tuple[Path, Path]) -> None:
    """And named on stderr, so that stdout stays data."""
    result = invoke(*arguments)
    assert result.exit_code == 0, result.output
    assert result.stderr.splitlines()[0] == f"fleet: the newest run: {two[1]}"
    assert "newest" not in result.stdout
    named = invoke(arguments[0], two[0], *arguments[1:])
    assert "newest" not in named.output


@pytest.mark.parametrize("arguments", [*LOG_COMMANDS, ["replay"], ["diff", __file__]])
def test_without_a_log_and_without_runs(arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke(*arguments)
    assert result.exit_code == 2
    said = "".join(result.stderr.split())
    assert "".join(f"no log is given, and there is no run below {tmp_path / 'runs'}".split()) in said


def test_diff_compares_with_the_newest(two: tuple[Path, Path]) -> None:
    result = invoke("diff", two[0], "-q")
    assert (result.exit_code, result.stderr) == (0, f"fleet: the newest run: {two[1]}\n")
    assert result.stdout.startswith("the same bit for bit")
    same = invoke("diff", "runs/latest")
    assert same.exit_code == 2 and "A is the newest run itself" in same.stderr


def test_replay_plays_the_newest(two: tuple[Path, Path]) -> None:
    result = invoke("replay", "--speed", "0", "--listen", "tcp/127.0.0.1:0", "-q")
    assert (result.exit_code, result.stderr) == (0, f"fleet: the newest run: {two[1]}\n")
