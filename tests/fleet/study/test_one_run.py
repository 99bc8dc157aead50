"""One run as a worker makes it, and laws that hang."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from failing_laws import failing
from small_scenario import SMALL
from waiting import wait_for

from fleet.scenario.loading import parse_scenario
from fleet.scenario.trust import Policy
from fleet.study.modules import modules_of
from fleet.study.one_run import FAILED, Task, make_run, make_run_in_time


@pytest.mark.parametrize("line", ["while True: pass", "time.sleep(3600.0)"])
def test_a_law_that_hangs_within_a_tick_costs_its_run(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fleet.study.one_run.GRACE_S", 0.1)
    name = "hanging_law" if "while" in line else "sleeping_law"
    (tmp_path / f"{name}.py").write_text(failing(3, line), "utf-8")
    text = f"{SMALL}controller: {name}:Law\n"
    scenario = parse_scenario(text, "small.yaml", folder=tmp_path, policy=Policy(stranger=""))
    before = set(threading.enumerate())
    task = Task("a", 2, 7, "small", scenario.to_yaml(), 0.2, modules_of([scenario], tmp_path))
    row = make_run_in_time(task)
    assert (row["status"], row["reason"], row["point"], row["seed"]) == (FAILED, "took longer than 0.2 s", 2, 7)
    if "while" in line:
        wait_for(lambda: set(threading.enumerate()) <= before, 60, "the thread to be ended")


def test_a_run_in_time_is_the_same_as_without_a_limit() -> None:
    task = Task("a", 0, 1, "small", SMALL, float("inf"))
    rows = [make_run(task), make_run_in_time(task._replace(timeout_s=600.0))]
    for row in rows:
        del row["wall_s"]
    assert str(rows[0]) == str(rows[1])
