"""Load and abuse, in small: each test is a row of docs/guide/reliability.md."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
from functools import partial
from pathlib import Path
from time import sleep

import pytest
from in_process_runs import recorded
from live import LiveRun
from spawned import fleet

CHECKS = "checks={ledger: balanced, middleware_loss: {at_most: 0}, tumbled: waived, deaths: waived}"


def undisturbed(folder: Path, *overrides: str) -> str:
    """The digest of the same run in one process."""
    return recorded(folder, "paper", CHECKS, *overrides).digest


def fleet_run(folder: Path, soft: int, hard: int) -> subprocess.CompletedProcess[str]:
    words = ["run", "paper", "--duration", "200 ms", "--set", CHECKS, "-q", "--out", folder]
    return fleet(*words, preexec_fn=partial(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard)))


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
        values = json.loads((run.directory / "result.json").read_text("utf-8"))
    assert values["digest"] == undisturbed(tmp_path / "same", "duration=4 s")
    assert values["middleware_lost"] == 0
