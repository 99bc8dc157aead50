"""A Dask cluster that is there: a scheduler and two workers as processes of their own, of which one is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from math import inf
from pathlib import Path
from types import ModuleType

import pytest
from failing_laws import failing
from small_scenario import SMALL, small
from waiting import wait_for

from fleet.scenario.loading import parse_scenario
from fleet.scenario.trust import Policy
from fleet.study.engine import remote_engine
from fleet.study.errors import StudyError
from fleet.study.modules import modules_of
from fleet.study.one_run import Task

LIMIT_S = 60.0


@contextmanager
def started(module: str, *options: str, folder: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """A program of Dask, ended with the context."""
    command = [sys.executable, "-m", f"distributed.cli.{module}", *options]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=folder)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_laws_travel_and_a_worker_of_a_cluster_that_is_killed_costs_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = tmp_path / "far"  # where workers look for modules
    far.mkdir()
    (tmp_path / "far_law.py").write_text("import helper_of_far_law\n" + failing(3, "pass"), "utf-8")
    (tmp_path / "helper_of_far_law.py").write_text("", "utf-8")
    (tmp_path / "lame_law.py").write_text("import only_here\n" + failing(3, "pass"), "utf-8")
    monkeypatch.setitem(sys.modules, "only_here", ModuleType("only_here"))
    scenarios = [
        parse_scenario(f"{SMALL}controller: {name}:Law\n", "small.yaml", folder=tmp_path, policy=Policy(stranger=""))
        for name in ("far_law", "lame_law")
    ]
    file = tmp_path / "scheduler.json"
    with ExitStack() as stack:
        where = ["--scheduler-file", str(file)]
        stack.enter_context(started("dask_scheduler", *where, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"))
        wait_for(file.exists, LIMIT_S, "the scheduler")
        own = [*where, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(tmp_path)]
        workers = [stack.enter_context(started("dask_worker", *own, folder=far)) for _ in range(2)]
        engine = stack.enter_context(remote_engine(json.loads(file.read_text("utf-8"))["address"]))
        wait_for(lambda: len(engine.client.nthreads()) == 2, LIMIT_S, "both workers")

        with pytest.raises(StudyError, match=r"worker tcp://127.0.0.1:\d+ lacks only_here"):
            engine.carry(modules_of(scenarios[1:], tmp_path))
        modules = engine.carry(modules_of(scenarios[:1], tmp_path))

        def kill_one() -> None:
            if workers[0].poll() is None:
                os.kill(workers[0].pid, signal.SIGKILL)
                workers[0].wait()

        text = small("duration=5 s").to_yaml()
        tasks = (Task(f"key-{seed}", 0, seed, "small", text, inf) for seed in range(10))
        rows: list[dict[str, object]] = []
        engine.make(tasks, rows.extend, kill_one)
        assert workers[0].poll() == -signal.SIGKILL
        assert sorted(str(row["key"]) for row in rows) == sorted(f"key-{seed}" for seed in range(10))
        assert {row["status"] for row in rows} <= {"pass", "check_failed"}
        law = Task("law", 0, 1, "small", scenarios[0].to_yaml(), inf, modules)
        rows.clear()
        engine.make(iter([law]), rows.extend, lambda: None)
        assert rows[0]["status"] in ("pass", "check_failed"), rows
