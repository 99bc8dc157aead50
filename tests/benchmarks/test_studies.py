"""What a run of a study costs is measured for every way of making runs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from click.testing import CliRunner
from study_engine import Here
from waiting import wait_for

from benchmarks.__main__ import main


class _Workers:
    """The worker is this process."""

    pids = (os.getpid(),)


class _Measured(Here):
    workers = _Workers()


@pytest.fixture(autouse=True)
def no_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def engine(_: int) -> Iterator[Here]:
        yield _Measured()

    monkeypatch.setattr("fleet.addons.studies.engine.local_engine", engine)


@pytest.mark.slow
def test_each_way_is_measured_beside_the_bare_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.studies.REPEATS", 1)
    arguments = ["study", "--runs", "1", "--duration", "0.5", "--workers", "1", "--json"]
    result = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert [way["way"] for way in document["ways"]] == ["concurrent.futures", "fleet search, shrink", "fleet sweep"]
    assert all(way["cpu_s"] > 0 and len(way["cpu_ratios"]) == len(way["speed_ups"]) == 1 for way in document["ways"])
    assert document["bare_cpu_s"] > 0


def test_memory_is_looked_at_along_the_way() -> None:
    result = CliRunner().invoke(main, ["study", "--memory", "20", "--json"], catch_exceptions=False)
    rows = json.loads(result.stdout)["memory"]
    assert [row["runs"] for row in rows] == list(range(2, 21, 2))
    assert all(row["worker_mb"] > 1 and row["here_mb"] > 1 for row in rows)
    shown = CliRunner().invoke(main, ["study", "--memory", "10"], catch_exceptions=False)
    assert "[MB]" in shown.stdout and shown.stdout.count("\n") > 10


@pytest.mark.slow
def test_ctrl_c_prints_no_traceback(tmp_path: Path) -> None:
    """All processes of the terminal get it, a worker that waits for a run, too."""
    command = [sys.executable, "-m", "benchmarks", "study", "--runs", "5", "--duration", "90", "--workers", "1"]
    printed = tmp_path / "printed"
    with printed.open("wb") as file:
        measured = subprocess.Popen(command, stdout=file, stderr=file, start_new_session=True)
    try:
        ours = psutil.Process(measured.pid)

        def used_s() -> float:
            assert measured.poll() is None, printed.read_text()
            workers = [one for one in ours.children() if "spawn_main" in " ".join(one.cmdline())]
            return sum(one.cpu_times().user for one in workers)

        def idle() -> bool:
            before = used_s()
            time.sleep(0.5)
            return before > 2.0 and used_s() == before

        wait_for(idle, 60, "the worker, which has made a run, has nothing to do while the bare runs are made")
        os.killpg(measured.pid, signal.SIGINT)
        assert measured.wait(60) == 130
    finally:
        measured.kill()
    assert "Traceback" not in printed.read_text()
