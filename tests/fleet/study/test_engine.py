"""Workers of this machine: who may use them, and what becomes of a study when one of them dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import chain
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import dask
import pytest
from failing_laws import failing
from small_scenario import SMALL, small
from waiting import wait_for

from fleet.processes.workers import WorkerDied
from fleet.scenario.loading import parse_scenario
from fleet.scenario.trust import Policy
from fleet.study.engine import LOST, Engine, check_versions, local_engine, need_extra, remote_engine, versions
from fleet.study.errors import StudyError
from fleet.study.modules import modules_of
from fleet.study.one_run import FAILED, Task

NAME = "small"
DONE = {"pass", "check_failed"}


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    with local_engine(2) as found:
        yield found


def tasks(count: int, duration: str = "1 s") -> Iterator[Task]:
    text = small(f"duration={duration}").to_yaml()
    return (Task(f"key-{seed}", 0, seed, NAME, text, inf) for seed in range(count))


def made(engine: Engine, tasks: Iterator[Task], **options: Any) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    engine.make(tasks, rows.extend, options.get("wait", lambda: None))
    return rows


def test_every_run_is_made_once(engine: Engine) -> None:
    rows = made(engine, tasks(25))
    assert sorted(row["seed"] for row in rows) == list(range(25))
    assert {row["status"] for row in rows} <= DONE


def workers(engine: Engine) -> set[int]:
    """The process ids of those that answer."""
    answers = engine.client.run(os.getpid, on_error="return")  # one may end while it is asked
    return {found for found in answers.values() if isinstance(found, int)}


def two_workers(engine: Engine) -> set[int]:
    """Their process ids; empty: there are not two."""
    found = workers(engine)
    return found if len(found) == 2 else set()


def test_a_worker_that_is_killed_costs_no_run(engine: Engine) -> None:
    before = workers(engine)
    killed: list[int] = []

    def kill_one() -> None:
        if not killed:
            killed.append(min(before))
            os.kill(killed[0], signal.SIGKILL)

    rows = made(engine, tasks(12, "8 s"), wait=kill_one)
    assert killed
    assert sorted(row["seed"] for row in rows) == list(range(12))
    assert {row["status"] for row in rows} <= DONE
    wait_for(lambda: len(workers(engine) - set(killed)) == 2, 30, "another worker in its place")


@pytest.mark.slow
def test_the_place_of_a_worker_that_dies_is_never_given_up() -> None:
    """Dask does so where a place is empty when some time has gone by since a worker died there."""
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "100 ms"}), local_engine(1) as engine:
        (killed,) = workers(engine)
        os.kill(killed, signal.SIGKILL)
        wait_for(lambda: workers(engine) - {killed}, 30, "another worker in its place")
        assert len(engine.client.cluster.workers) == 1  # places


@pytest.mark.slow
def test_a_law_of_the_users_runs_there_and_one_that_kills_its_workers_costs_its_run(
    engine: Engine, tmp_path: Path
) -> None:
    laws = {"good_law": "pass", "deadly_law": "__import__('os')._exit(1)"}
    scenarios = []
    for name, line in laws.items():
        (tmp_path / f"{name}.py").write_text(failing(3, line), "utf-8")
        text = f"{SMALL}controller: {name}:Law\n"
        scenarios.append(parse_scenario(text, "small.yaml", folder=tmp_path, policy=Policy(stranger="")))
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
    rows = {row["key"]: row for row in made(engine, iter(chosen))}
    assert {rows[key]["status"] for key in "ac"} <= DONE
    assert (rows["b"]["status"], rows["b"]["reason"]) == (FAILED, LOST)
    assert rows["d"]["status"] == FAILED
    assert "a study names it" in rows["d"]["reason"]


class Lost(SimpleNamespace):
    """A batch of a worker that makes one after the other: some kill it, and then all that it was given is lost."""

    status = "error"

    def exception(self) -> Exception:
        return WorkerDied("gone")

    def result(self) -> list[dict[str, Any]]:
        return [{"key": task.key, "wall_s": 1.0, "status": "pass"} for task in self.batch]

    __hash__ = object.__hash__


@pytest.mark.parametrize("begins", [True, False], ids=["while it makes a run", "before it begins with any"])
def test_only_the_run_that_a_worker_made_when_it_died_is_blamed(
    begins: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def finished(under_way: dict[Lost, list[Task]], wait: Any) -> list[Lost]:
        first, *_ = under_way
        (task,) = first.batch
        if not task.key.startswith("deadly"):
            first.status = "finished"
            return [first]
        if begins:
            Path(task.note).touch()
        return list(under_way)

    monkeypatch.setattr("fleet.study.engine._finished", finished)
    client: Any = SimpleNamespace(submit=lambda _, batch, pure: Lost(batch=batch))
    engine = Engine(client, 1, "", here=True, notes=str(tmp_path))
    killers = (task._replace(key=f"deadly-{task.seed}") for task in tasks(4))
    rows = {row["key"]: row for row in made(engine, chain(killers, tasks(4)))}
    assert {row["reason"] for key, row in rows.items() if key.startswith("deadly")} == {LOST}
    good = {row["status"] for key, row in rows.items() if not key.startswith("deadly")}
    assert good == {"pass"} if begins else len(rows) == 8  # it comes to an end all the same
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_law_that_lets_nothing_else_run_ends_its_worker_once(engine: Engine, tmp_path: Path) -> None:
    (tmp_path / "stuck_law.py").write_text(failing(3, "__import__('re').match('(a+)+b', 'a' * 60)"), "utf-8")
    stuck = parse_scenario(
        f"{SMALL}controller: stuck_law:Law\n", "small.yaml", folder=tmp_path, policy=Policy(stranger="")
    )
    modules = modules_of([stuck], tmp_path)
    before = wait_for(lambda: two_workers(engine), 30, "two workers: a test before may have ended one")
    good = (task._replace(timeout_s=30.0) for task in tasks(4))
    rows = made(engine, iter([Task("stuck", 1, 1, NAME, stuck.to_yaml(), 1.0, modules), *good]))
    assert [row["reason"] for row in rows if row["key"] == "stuck"] == ["took longer than 1 s"]
    assert {row["status"] for row in rows if row["key"] != "stuck"} <= DONE
    assert len(before - wait_for(lambda: two_workers(engine), 30, "another worker in its place")) == 1


STRANGER = """
import sys
from distributed import Client
for address in sys.argv[1:]:
    try:
        Client(address, timeout="1s").run(print)
    except (OSError, TypeError) as error:
        print("refused")
"""


def test_a_stranger_on_this_host_is_refused(engine: Engine) -> None:
    address = engine.client.scheduler.address
    assert address.startswith("tls://127.0.0.1:")
    plain = address.replace("tls://", "tcp://")
    done = subprocess.run([sys.executable, "-c", STRANGER, address, plain], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["refused", "refused"]


def test_no_scheduler_and_no_extra_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.study.engine._CONNECT_S", 0.3)
    with pytest.raises(StudyError, match="no Dask scheduler answers at tcp://127"), remote_engine("tcp://127.0.0.1:1"):
        pass
    with pytest.raises(StudyError, match="needs certificates: set DASK_"), remote_engine("tls://127.0.0.1:1"):
        pass
    monkeypatch.setattr("fleet.study.engine.NEEDED", ("dask", "no_such_library"))
    with pytest.raises(StudyError, match=r"studies need no_such_library: pip install 'uuv-fleet\[study\]'"):
        need_extra()


class _Cluster:
    """A client whose workers answer what a test wants."""

    def __init__(self, found: object) -> None:
        self.found = found

    def run(self, *_: Any, **__: Any) -> dict[str, object]:
        return {"tcp://10.0.0.2:1": versions(), "tcp://10.0.0.3:1": self.found}


def test_workers_with_other_versions_are_told_apart_before_the_first_run() -> None:
    check_versions(_Cluster(versions()))  # type: ignore[arg-type]
    with pytest.raises(StudyError, match=r"worker tcp://10.0.0.3:1 has numpy 1.0 \(here "):
        check_versions(_Cluster(versions() | {"numpy": "1.0"}))  # type: ignore[arg-type]
    with pytest.raises(StudyError, match=r"worker tcp://10.0.0.3:1 lacks fleet"):
        check_versions(_Cluster(ModuleNotFoundError("No module named 'fleet'", name="fleet")))  # type: ignore[arg-type]
