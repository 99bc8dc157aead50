"""Load and abuse, in small: each test is a row of docs/guide/reliability.md."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from time import sleep

import pytest
from live import LiveRun

from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.scenario.loading import load_scenario

CHECKS = "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived, deaths: waived}"


def result(directory: Path) -> dict[str, object]:
    values: dict[str, object] = json.loads((directory / "result.json").read_text("utf-8"))
    return values


def undisturbed(folder: Path, *overrides: str) -> str:
    """The digest of the same run in one process."""
    return execute(load_scenario("paper", [CHECKS, *overrides]), Options(folder, in_process=True, quiet=True)).digest


def few_files(soft: int, hard: int) -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def fleet_run(folder: Path, soft: int, hard: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "fleet", "run", "paper", "--duration", "200 ms", "--set", CHECKS, "-q"]
    return subprocess.run(
        [*command, "--out", str(folder)],
        preexec_fn=partial(few_files, soft, hard),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.slow
def test_too_few_open_files_are_said_before_anything_starts(tmp_path: Path) -> None:
    found = fleet_run(tmp_path, 40, 40)
    assert (found.returncode, found.stdout) == (3, f"{(tmp_path / 'latest').resolve()}\n")
    assert "4 vehicles need 56 open files per process, and the limit here is 40" in found.stderr
    assert "Traceback" not in found.stderr


@pytest.mark.slow
def test_a_low_soft_limit_of_open_files_is_raised(tmp_path: Path) -> None:
    found = fleet_run(tmp_path, 20, 4096)
    assert (found.returncode, found.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("whole", [pytest.param(False, id="console"), pytest.param(True, id="whole-group")])
def test_a_suspended_console_only_takes_longer(tmp_path: Path, whole: bool) -> None:
    with LiveRun(tmp_path, "paper", "--duration", "4 s", "--speed", "4", "--set", CHECKS) as run:
        run.until_running(1.0)
        run.send(signal.SIGSTOP, group=whole)
        sleep(1.0)
        run.send(signal.SIGCONT, group=whole)
        assert run.status() == 0
        values = result(run.directory)
    assert values["digest"] == undisturbed(tmp_path / "same", "duration=4 s")
    assert values["middleware_lost"] == 0
