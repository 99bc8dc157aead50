"""The benchmark runs and reports everything it promises; how fast anything is, is no test's business."""

from __future__ import annotations

import json
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console as Terminal
from soak import Soak
from waiting import wait_for

from fleet.__main__ import _command_line
from fleet.bench import barriers, journal, measured_run
from fleet.bench.figures import Collector, now, this_machine
from fleet.bench.fleets import CPU, DISTRIBUTED, IN_PROCESS, PIPES, READY, ZENOH, goals, measure_fleets
from fleet.bench.network_core import SHARE
from fleet.bench.start_up import COMMANDS, PYTHON
from fleet.bench.tables import show
from fleet.bench.wall_clock import measure_wall_clock as measure_real
from fleet.bench.wall_clock import show_wall_clock
from fleet.cli.main import cli
from fleet.errors import FleetError
from fleet.result.result import Result, Status
from fleet.scenario.loading import load_scenario


@pytest.mark.slow
def test_quick_bench_reports_every_figure() -> None:
    heard: list[str] = []
    found = measure_fleets([2], quick=True, say=heard.append)
    names = {figure.name for figure in found.figures}
    assert {f"N = 2: {name}" for name in (ZENOH, PIPES, DISTRIBUTED, IN_PROCESS, CPU, READY)} <= names
    assert {"N = 2: journal written", "network core: perfect", f"network core: {SHARE}"} <= names
    assert {f"start: {name}" for name in COMMANDS if name != PYTHON} <= names
    assert sum(name.startswith("policies: ") for name in names) == 2
    assert {"step: agent step", "step: QP: solve (PIQP, fresh solver)", "step: controller alone, bsmc"} <= names
    assert sum(name.startswith("four vehicles: tick 100 ms") for name in names) == 2
    assert all(min(figure.samples) > 0 for figure in found.figures)
    assert all(len(figure.ratios) == len(figure.samples) for figure in found.figures if figure.baseline)
    assert (found.quick, found.machine.cpus > 0, found.versions["uuv-fleet"] != "") == (True, True, True)
    assert heard[-1] == "the network core, start-up, single steps and policies, 1 of 1"
    shown = Terminal(width=120, record=True, file=StringIO())
    show(found, shown)
    text = shown.export_text()
    assert all(
        name.partition(": ")[2] in text
        for name in names
        if name.startswith(("step", "network", "start", "four", "policies"))
    )


def test_goals_say_met_or_missed() -> None:
    found = Collector()
    for c, ready in ((1200.0, 0.4), (1600.0, 0.6)):
        found.add(f"N = 4: {DISTRIBUTED}", "ticks/s", c, ZENOH, 10_000.0)
        found.add(f"N = 4: {READY}", "s", ready, higher=False)
        found.add(f"network core: {SHARE}", "1", ready, higher=False)
    assert goals(found.measured(quick=False, machine=this_machine(), began=now())) == [
        "MISSED N = 4: c distributed / a zenoh barrier: 0.14, at least 0.35",
        "met    N = 4: c distributed: 1,600 ticks/s, at least 1500",
        "met    N = 4: ready: 0.40 s, at most 0.5",
        "MISSED network core: share of a run, N = 20: 0.40, at most 0.1",
    ]


def test_a_fleet_that_is_asked_too_much_does_not_fit() -> None:
    """A thousand times real time, 100,000 ticks/s, is more than any machine makes."""
    (row,) = measure_real([2], [1000.0], 0.5, lambda text: None)
    assert (row.vehicles, row.label, row.fit, row.same_bytes) == (2, "degraded", False, False)
    assert row.lockstep_x > 0
    rendered = Terminal(width=200, record=True, file=StringIO())
    show_wall_clock([row], rendered)
    assert "degraded (fails)" in rendered.export_text()


@pytest.mark.parametrize(
    ("verb", "status", "reason", "exit_status", "line"),
    [
        ((), Status.BROKEN, "no agent came", 3, "broke: no agent came"),
        ((), Status.INTERRUPTED, "interrupted", 130, "was ended: interrupted"),
        ((), Status.CHECK_FAILED, "", 3, "did not pass its checks: "),
        (("real",), Status.BROKEN, "no agent came", 3, "broke: no agent came"),
        (("real",), Status.HUNG_UP, "terminal closed", 129, "was ended: terminal closed"),
    ],
)
def test_a_run_that_does_not_end_is_one_line(
    verb: tuple[str, ...],
    status: Status,
    reason: str,
    exit_status: int,
    line: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Not a traceback, which `fleet bench` gave until then; Ctrl-C and SIGTERM come as an interrupted run."""

    def execute(*_: Any) -> Result:
        return Result(status=status, reason=reason)

    monkeypatch.setattr(measured_run, "execute", execute)
    monkeypatch.setattr("fleet.bench.fleets.zenoh_barrier", lambda n, ticks: 1.0)
    monkeypatch.setattr("fleet.bench.fleets.pipe_barrier", lambda n, ticks: 1.0)
    monkeypatch.setattr(sys, "argv", ["fleet", "bench", *verb, "--agents", "2", "--quick"])
    try:
        found = _command_line()
    except SystemExit as end:
        found = int(end.code or 0)
    assert found == exit_status
    assert capsys.readouterr().err.splitlines()[-1] == f"fleet: the run with 2 vehicles {line}"


def test_a_directory_is_no_file_for_figures() -> None:
    result = CliRunner().invoke(cli, ["bench", "--quick", "-o", ""])
    assert result.exit_code == 2 and "cannot be written: it is a directory" in result.stderr
    result = CliRunner().invoke(cli, ["bench", "--quick", "-o", "--help"])
    assert result.exit_code == 2 and "expected the file to write, got the option --help" in result.stderr


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


def test_a_recorder_that_misses_messages_ends_the_benchmark(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "PATIENCE_S", -1.0)
    with pytest.raises(FleetError, match="messages did not reach the recorder"):
        journal.measure_recorder(load_scenario("paper", ["duration=500 ms"]), lambda text: None)


def test_scale_gives_every_role_its_part(tmp_path: Path) -> None:
    """A row per size as soon as it is measured, the same in the file, and the curve as a picture."""
    figures, picture = tmp_path / "scale.json", tmp_path / "scale.png"
    arguments = ["bench", "scale", "--quick", "--agents", "2,3", "-o", str(figures), "--picture", str(picture)]
    found = CliRunner().invoke(cli, arguments)
    assert found.exit_code == 0, found.output
    rows = json.loads(figures.read_text())["rows"]
    assert [row["vehicles"] for row in rows] == [2, 3]
    for row in rows:
        assert set(row["distributed_us"]) == {"console", "world", "netem", "agents"}
        assert min(row["distributed_us"].values()) >= 0 < sum(row["distributed_us"].values())  # a clock of 10 ms
        assert row["in_process_us"] > 0 and row["ready_s"] > 0 and row["x_real_time"] > 0
        assert 1.0 < row["agent_mb"] < row["all_mb"]
    assert [line.split()[0] for line in found.stdout.splitlines()[-2:]] == ["2", "3"]
    assert picture.read_bytes().startswith(b"\x89PNG")
