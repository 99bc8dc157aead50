"""The benchmark reports what it promises; how fast anything is, is no test's business."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from repository import ROOT
from soak import Soak
from waiting import wait_for

from benchmarks import barriers, fleets
from benchmarks.__main__ import main
from benchmarks.barriers import ZENOH
from benchmarks.figures import Measured, read
from benchmarks.fleets import CPU, DISTRIBUTED, IN_PROCESS, READY
from benchmarks.start_up import COMMANDS, PYTHON
from fleet.errors import FleetError
from fleet.result.result import Result, Status


@pytest.mark.slow
def test_every_figure_is_measured_compared_and_written(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "benchmarks", "--quick", "--agents", "2"]
    first = subprocess.run(
        [*command, "-o", tmp_path / "old.json"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    found: Measured = read(tmp_path / "old.json")
    names = {figure.name for figure in found.figures}
    assert {f"N = 2: {name}" for name in (ZENOH, DISTRIBUTED, IN_PROCESS, CPU, READY, "journal written")} <= names
    assert {f"start: {name}" for name in COMMANDS if name != PYTHON} <= names
    assert sum(name.startswith("four vehicles: tick 100 ms") for name in names) == 2
    assert all(len(figure.ratios) == len(figure.samples) for figure in found.figures if figure.baseline)
    assert found.machine["quick"] == "True" and found.versions["uuv-fleet"]
    assert all(name in first.stdout for name in names)


@pytest.mark.parametrize(
    ("status", "reason", "exit_status", "line"),
    [
        (Status.BROKEN, "no agent came", 3, "broken, no agent came"),
        (Status.INTERRUPTED, "interrupted", 130, "interrupted, interrupted"),
        (Status.CHECK_FAILED, "", 3, "check_failed"),
    ],
)
def test_a_run_that_does_not_end_is_one_line(
    status: Status, reason: str, exit_status: int, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def execute(*_: Any) -> Result:
        return Result(status=status, reason=reason)

    monkeypatch.setattr(fleets, "execute", execute)
    monkeypatch.setattr(fleets, "zenoh_barrier", lambda n, ticks: 1.0)
    result = CliRunner().invoke(main, ["--agents", "2", "--quick"])
    assert result.exit_code == exit_status
    assert result.stderr.splitlines()[-1] == f"benchmarks: the run with 2 vehicles ended: {line}"


@pytest.mark.slow
def test_a_soak_that_is_ended_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that is killed leaves the folder of its router; so it is asked to end first."""
    monkeypatch.setenv("TMPDIR", str(tmp_path / "t"))
    (tmp_path / "t").mkdir()
    soak = Soak("one", ["paper", "--speed", "1"], tmp_path)
    try:
        wait_for(lambda: list(tmp_path.glob("one/*/connection.json")) or not soak.running, 60.0, "the run")
        assert soak.running
    finally:
        soak.stop()
    assert list((tmp_path / "t").iterdir()) == []
    assert "interrupted" in (tmp_path / "one.txt").read_text()


def test_echo_agents_that_do_not_answer_end_the_benchmark(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(barriers, "READY_S", -1.0)
    with pytest.raises(FleetError, match="echo agents did not answer within"):
        barriers.zenoh_barrier(2, 1)


def test_scale_gives_every_role_its_part(tmp_path: Path) -> None:
    """A row per size as soon as it is measured, and the same in the file."""
    figures = tmp_path / "scale.json"
    found = CliRunner().invoke(main, ["scale", "--quick", "--agents", "2,3", "-o", str(figures)])
    assert found.exit_code == 0, found.output
    rows = json.loads(figures.read_text())["rows"]
    assert [row["vehicles"] for row in rows] == [2, 3]
    for row in rows:
        assert set(row["distributed_us"]) == {"console", "world", "netem", "agents"}
        assert min(row["distributed_us"].values()) >= 0 < sum(row["distributed_us"].values())  # a clock of 10 ms
        assert row["in_process_us"] > 0 and row["ready_s"] > 0 and row["x_real_time"] > 0
        assert 1.0 < row["agent_mb"] < row["all_mb"]
    assert [line.split()[0] for line in found.stdout.splitlines()[-2:]] == ["2", "3"]
