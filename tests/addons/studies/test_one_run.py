"""One run as a worker makes it, and laws that hang."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from failing_laws import failing, with_law
from in_process_runs import Alone, log_of
from marks import slow
from ranged import DYING
from small_scenario import SMALL
from waiting import wait_for

from fleet.addons.studies.modules import modules_of
from fleet.addons.studies.one_run import Task, make_run, make_run_in_time
from fleet.addons.studies.row import FAILED
from fleet.logs.open_log import open_log
from fleet.scenario.loading import load_scenario


@pytest.mark.parametrize("line", ["while True: pass", "time.sleep(3600.0)"])
def test_a_law_that_hangs_within_a_tick_costs_its_run(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fleet.addons.studies.one_run.GRACE_S", 0.1)
    name = "hanging_law" if "while" in line else "sleeping_law"
    scenario = with_law(tmp_path, name, failing(3, line))
    before = set(threading.enumerate())
    task = Task("a", 2, 7, "small", scenario.to_yaml(), 0.2, modules_of([scenario], tmp_path))
    row = make_run_in_time(task)
    assert (row.status, row.reason, row.point, row.seed) == (FAILED, "took longer than 0.2 s", 2, 7)
    if "while" in line:
        wait_for(lambda: set(threading.enumerate()) <= before, 60, "the thread to be ended")


@pytest.mark.parametrize("name", ["locate-consistent", *slow("navigation-aid", "locate-naive", "locate-naive-loop")])
def test_a_run_with_ranges_has_the_same_bytes_in_a_study(name: str, alone: Alone) -> None:
    """Distributed it has them by `tests/golden/test_gallery.py`, and resumed by `tests/fleet/repeat/test_resume.py`."""
    dying = name == "locate-consistent"
    changes = ["duration=7 s", "checks={tumbled: waived}", "expect=pass", *(DYING if dying else [])]
    result = alone(name, *changes)
    known = open_log(log_of(result))["uuv/2/guidance"]
    before, after = known.ranges_used[known.t < 2.0][-1], known.ranges_used[-1]
    assert before == after == 1 if dying else after > 0, "this would prove nothing"
    scenario = load_scenario(name, changes)
    row = make_run(Task("a", 0, scenario.seed, name, scenario.to_yaml(), float("inf")))
    assert row.digest == result.digest


def test_a_run_in_time_is_the_same_as_without_a_limit() -> None:
    task = Task("a", 0, 1, "small", SMALL, float("inf"))
    rows = [make_run(task), make_run_in_time(task._replace(timeout_s=600.0))]
    for row in rows:
        del row.numbers["wall_s"]
    assert str(rows[0]) == str(rows[1])
