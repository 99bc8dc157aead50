"""A Dask cluster that is there: who may use it, and what becomes of a study when one of its workers dies."""

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
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from failing_laws import failing, with_law
from small_scenario import SMALL, small
from tool import invoke
from waiting import wait_for

from fleet.addons.studies.dask_engine import DaskEngine, check_versions, dask_engine, versions
from fleet.addons.studies.engine_interface import LOST, require_extra
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import modules_of
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import FAILED, Row

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


FAILS = """\
nemesis: {every: 400 ms, for: 300 ms, pick: [mute, deaf, {wrench: {vehicles: 1, force: 400 0 0 N}}]}
checks: {formation_error: {below: 4.6 m, after: 800 ms}, max_age: {below: 999 ms}, tumbled: waived}
"""
OF_MANY_RUNS = [
    ["search", "small.yaml", "--budget", "4", "--force"],
    ["search", "small.yaml", "--budget", "4", "--keep", "kept"],
    ["regress", "kept"],
    ["shrink", "small.yaml", "--set", "seed=2", "--force"],
    ["rare", "small.yaml", "--check", "formation_error", "--repeats", "3", "--effort", "4",
     "--net", "* loss 60%", "--set", "nemesis=null"],
    ["why", "run"],
]  # fmt: skip


def _settled(text: str) -> str:
    """A document without the number of runs, which counts those that were under way with the first one that fails."""
    document = json.loads(text)
    document.pop("runs", None)
    return json.dumps(document)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_every_command_of_many_runs_gives_the_same_on_a_cluster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed import LocalCluster

    said: list[list[str]] = []
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        for name, where in (("here", ["--workers", "1"]), ("there", ["--scheduler", cluster.scheduler_address])):
            (tmp_path / name).mkdir()
            monkeypatch.chdir(tmp_path / name)
            Path("small.yaml").write_text(SMALL + FAILS, "utf-8")
            made = invoke("run", "small.yaml", "--in-process", "--seed", "2", "--out", ".", "--quiet")
            Path(made.stdout.split()[-1]).rename("run")
            results = [invoke(*command, *where, "--json") for command in OF_MANY_RUNS]
            said.append([f"{result.exit_code} {_settled(result.stdout)}" for result in results])
    for command, here, there in zip(OF_MANY_RUNS, *said, strict=True):
        assert here == there, command
        assert here[0] in "01", (command, here)


@pytest.mark.slow
def test_laws_travel_and_a_worker_of_a_cluster_that_is_killed_costs_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = tmp_path / "far"  # where workers look for modules
    far.mkdir()
    (tmp_path / "helper_of_far_law.py").write_text("", "utf-8")
    monkeypatch.setitem(sys.modules, "only_here", ModuleType("only_here"))
    needs = {"far_law": "helper_of_far_law", "lame_law": "only_here"}
    scenarios = [with_law(tmp_path, name, f"import {other}\n" + failing(3, "pass")) for name, other in needs.items()]
    file = tmp_path / "scheduler.json"
    with ExitStack() as stack:
        where = ["--scheduler-file", str(file)]
        stack.enter_context(started("dask_scheduler", *where, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"))
        wait_for(lambda: file.exists() and file.read_text("utf-8").strip().endswith("}"), LIMIT_S, "the scheduler")
        own = [*where, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(tmp_path)]
        workers = [stack.enter_context(started("dask_worker", *own, folder=far)) for _ in range(2)]
        engine = stack.enter_context(dask_engine(json.loads(file.read_text("utf-8"))["address"]))
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
        assert sorted(row.key for row in rows) == sorted(f"key-{seed}" for seed in range(10))
        assert {row.status for row in rows} <= {"pass", "check_failed"}
        law = Task("law", 0, 1, "small", scenarios[0].to_yaml(), inf, modules)
        rows.clear()
        engine.make(iter([law]), rows.extend, lambda: None)
        assert rows[0].status in ("pass", "check_failed"), rows


def test_no_scheduler_and_no_extra_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.addons.studies.dask_engine._CONNECT_S", 0.3)
    with pytest.raises(StudyError, match="no Dask scheduler answers at tcp://127"), dask_engine("tcp://127.0.0.1:1"):
        pass
    with pytest.raises(StudyError, match="needs certificates: set DASK_"), dask_engine("tls://127.0.0.1:1"):
        pass
    monkeypatch.setattr("fleet.addons.studies.engine_interface.NEEDED", ("pandas", "no_such_library"))
    with pytest.raises(StudyError, match=r"studies need no_such_library: pip install 'uuv-fleet\[study\]'"):
        require_extra()
    monkeypatch.setattr("fleet.addons.studies.dask_engine._OF_CLUSTERS", ("no_such_library",))
    with pytest.raises(StudyError, match=r"a cluster needs no_such_library: .*\[cluster\]'"), dask_engine("tcp://x:1"):
        pass


class _Cluster:
    """A client whose workers answer what a test wants."""

    def __init__(self, found: object) -> None:
        self.found = found

    def run(self, *_: Any, **__: Any) -> dict[str, object]:
        return {"tcp://10.0.0.2:1": versions(), "tcp://10.0.0.3:1": self.found}


def test_workers_with_other_versions_are_told_apart_before_the_first_run() -> None:
    check_versions(_Cluster(versions()))
    with pytest.raises(StudyError, match=r"worker tcp://10.0.0.3:1 has numpy 1.0 \(here "):
        check_versions(_Cluster(versions() | {"numpy": "1.0"}))
    with pytest.raises(StudyError, match=r"worker tcp://10.0.0.3:1 lacks fleet"):
        check_versions(_Cluster(ModuleNotFoundError("No module named 'fleet'", name="fleet")))


class KilledWorker(Exception):
    """What Dask says of a run whose workers died."""


class _Future(SimpleNamespace):
    __hash__ = object.__hash__

    @property
    def status(self) -> str:
        return "error" if self.error else "finished"

    def exception(self) -> Exception | None:
        return self.error

    def result(self) -> Row:
        return Row(seed=1, key=self.task.key, status="pass")


def test_only_a_run_that_was_alone_with_its_worker_is_blamed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask counts the death of a worker to every run that it had been given."""
    given: list[_Future] = []  # to the one worker, which makes one after the other

    def submit(_: Any, task: Task, pure: bool) -> _Future:
        given.append(_Future(task=task, error=None))
        return given[-1]

    def finished(under_way: dict[_Future, Task], wait: Any) -> list[_Future]:
        if not given[0].task.key.startswith("deadly"):
            return [given.pop(0)]
        ended = given[:]
        given.clear()
        for future in ended:
            future.error = KilledWorker()
        return ended

    monkeypatch.setattr("fleet.addons.studies.dask_engine._wait_for_finished", finished)
    client: Any = SimpleNamespace(submit=submit)
    keys = ["deadly-1", "good-1", "good-2", "good-3", "deadly-2", "good-4", "good-5"]
    rows: list[Row] = []
    tasks = (Task(key, 0, 1, "small", "", inf) for key in keys)
    DaskEngine(client, 1).make(tasks, rows.extend, lambda: None)
    found = {row.key: (row.status, row.reason) for row in rows}
    assert found == {key: (FAILED, LOST) if key.startswith("deadly") else ("pass", "") for key in keys}
    assert len(rows) == len(keys)
