"""Workers of this machine: who can reach them, and what becomes of a study when one of them dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import chain
from math import inf
from pathlib import Path
from typing import Any

import psutil
import pytest
from failing_laws import failing, with_law
from marks import slow
from small_scenario import small

from fleet.addons.studies.engine import LocalEngine, local_engine
from fleet.addons.studies.engine_interface import LOST
from fleet.addons.studies.modules import modules_of
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import FAILED

NAME = "small"
DONE = {"pass", "check_failed"}

WITHOUT = """
import sys
from math import inf
for name in ("dask", "distributed", "scipy", "pandas", "xarray", "cryptography"):
    sys.modules[name] = None  # as if it were not installed
from fleet.addons.studies.engine import engine_of
from fleet.addons.studies.modules import NO_MODULES
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.search import search
from fleet.addons.studies.shrink import Shrinker
tasks = [Task(f"key-{seed}", 0, seed, "small", sys.argv[1], inf) for seed in (1, 2)]
with engine_of(NO_MODULES, 1) as engine:  # a script needs no `if __name__ == "__main__"`
    engine.make(iter(tasks), lambda rows: print(*[(row.key, row.status) for row in rows]), lambda: None)
for name in ("scipy", "pandas", "xarray"):
    del sys.modules[name]
import fleet.addons.studies.study
print("and a study")
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What a script says that makes runs without any library of the extra, and then lacks only those of a cluster."""
    script = tmp_path_factory.mktemp("script") / "script.py"
    script.write_text(WITHOUT, "utf-8")
    text = small("duration=100 ms", "checks={}").to_yaml()
    done = subprocess.run([sys.executable, script, text], capture_output=True, text=True, check=False)
    print(done.stderr)
    return done.stdout.splitlines()


def test_it_needs_no_library_of_the_extra(said: list[str]) -> None:
    assert said[:2] == ["('key-1', 'pass')", "('key-2', 'pass')"]


def test_a_study_on_this_machine_does_not_load_what_a_cluster_needs(said: list[str]) -> None:
    assert said[2:] == ["and a study"]


@pytest.fixture(scope="module")
def engine() -> Iterator[LocalEngine]:
    with local_engine(2) as found:
        yield found


def tasks(count: int, duration: str = "1 s", timeout_s: float = inf) -> Iterator[Task]:
    text = small(f"duration={duration}").to_yaml()
    return (Task(f"key-{seed}", 0, seed, NAME, text, timeout_s) for seed in range(count))


def made(engine: LocalEngine, tasks: Iterator[Task], **options: Any) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    engine.make(tasks, rows.extend, options.get("wait", lambda: None))
    return rows


def test_every_run_is_made_once(engine: LocalEngine) -> None:
    rows = made(engine, tasks(25, "200 ms"))
    assert sorted(row.seed for row in rows) == list(range(25))
    assert {row.status for row in rows} <= DONE


def test_nobody_can_connect_to_the_workers(engine: LocalEngine) -> None:
    made(engine, tasks(2, "100 ms"))
    workers = [psutil.Process(pid) for pid in engine.workers.pids]
    assert workers and not [found for process in workers for found in process.net_connections("inet")]


def test_a_worker_that_is_killed_costs_no_run(engine: LocalEngine) -> None:
    made(engine, tasks(2, "100 ms"))
    killed: list[int] = []

    def kill_one() -> None:
        if not killed:
            killed.append(min(engine.workers.pids))
            os.kill(killed[0], signal.SIGKILL)

    rows = made(engine, tasks(12, "3 s"), wait=kill_one)
    assert killed
    assert sorted(row.seed for row in rows) == list(range(12))
    assert {row.status for row in rows} <= DONE
    assert len(set(engine.workers.pids) - set(killed)) == 2  # another worker in its place


def test_a_law_of_the_users_runs_there_and_one_that_kills_its_workers_costs_its_run(
    engine: LocalEngine, tmp_path: Path
) -> None:
    laws = {"good_law": "pass", "deadly_law": "__import__('os')._exit(1)"}
    scenarios = [with_law(tmp_path, name, failing(3, line)) for name, line in laws.items()]
    modules = modules_of(scenarios, tmp_path)
    strange = tmp_path / "strange"  # where nothing was ever let in
    strange.mkdir()
    (strange / "strange_law.py").write_text(failing(3, "pass  # another file"), "utf-8")
    assert len(modules.files) == len(modules.fingerprints) == 2
    good, deadly = (scenario.to_yaml() for scenario in scenarios)
    chosen = [
        Task("a", 0, 1, NAME, good, inf, modules),
        Task("b", 1, 1, NAME, deadly, inf, modules),
        Task("c", 0, 2, NAME, good, inf, modules),
        Task("d", 2, 1, NAME, good.replace("good_law", "strange_law"), inf, modules._replace(folder=str(strange))),
    ]
    rows = {row.key: row for row in made(engine, chain(chosen, tasks(6, "100 ms")))}
    assert {row.status for key, row in rows.items() if key in "ac" or key.startswith("key")} <= DONE
    assert (rows["b"].point, rows["b"].seed, rows["b"].status, rows["b"].reason) == (1, 1, FAILED, LOST)
    assert rows["d"].status == FAILED
    assert "a study names it" in rows["d"].reason
    assert len(rows) == 10


@pytest.mark.parametrize(
    "line", ["__import__('re').match('(a+)+b', 'a' * 60)", *slow("while True: pass", "time.sleep(3600.0)")]
)
def test_a_law_that_hangs_within_a_tick_costs_its_run_and_its_worker_once(
    line: str, engine: LocalEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fleet.addons.studies.engine.GRACE_S", 0.1)
    name = f"stuck_law_{len(line)}"
    stuck = with_law(tmp_path, name, failing(3, line))
    modules = modules_of([stuck], tmp_path)
    made(engine, tasks(4, "100 ms"))
    before = set(engine.workers.pids)
    assert len(before) == 2
    task = Task("stuck", 1, 1, NAME, stuck.to_yaml(), 0.2, modules)
    rows = made(engine, chain([task], tasks(4, "100 ms", timeout_s=60.0)))
    assert [row.reason for row in rows if row.key == "stuck"] == ["took longer than 0.2 s"]
    assert {row.status for row in rows if row.key != "stuck"} <= DONE
    assert len(rows) == 5
    made(engine, tasks(4, "100 ms"))
    assert len(before - set(engine.workers.pids)) == 1


def test_a_run_that_ends_between_two_ticks_keeps_its_worker(engine: LocalEngine) -> None:
    made(engine, tasks(4, "100 ms"))
    before = set(engine.workers.pids)
    (row,) = made(engine, tasks(1, "1 h", 0.2))
    assert (row.status, row.reason) == (FAILED, "took longer than 0.2 s")
    assert set(engine.workers.pids) == before
