"""A run that is judged and not recorded is the run that would be recorded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from failing_laws import failing
from failing_laws import module as module
from refusals import check_refusals
from small_scenario import SMALL, small

import fleet
from fleet.execution.execute import execute
from fleet.execution.options import Options
from fleet.execution.stepped_run import override_texts
from fleet.execution.whole_run import run
from fleet.result.result import Status
from fleet.scenario.loading import parse_scenario

FAILING = {"checks": {"formation_error": {"below": "1 mm", "after": "0 s"}}}


def test_the_result_is_that_of_a_recorded_run(tmp_path: Path) -> None:
    changes = {"network.links.*.loss": "30 %", "faults": [{"at": "200 ms", "kill": 3}], **FAILING}
    found = run(small(), set=FAILING, net=["* loss 30 %"], fault=["at 200 ms kill 3"], seed=5)
    scenario = parse_scenario(SMALL, "small.yaml", [*override_texts(changes), "seed=5"])
    recorded = execute(scenario, Options(tmp_path, in_process=True, quiet=True))
    assert found.status is recorded.status is Status.CHECK_FAILED
    assert not found.passed
    assert found.directory is None
    assert found.digest == recorded.digest
    assert found.checks == recorded.checks
    same = set(found.values) - {"wall", "log_bytes"}
    assert {key: found.values[key] for key in same} == {key: recorded.values[key] for key in same}
    assert same > {"checks", "vehicles", "ledger", "ages", "faults", "deaths", "notes"}


@pytest.mark.parametrize("every", [1, 80])
def test_it_ends_however_rarely_the_scenario_logs(every: int) -> None:
    seen: list[float] = []
    found = run("paper", set=["duration=2 s", "checks={}", f"log={{every: {every} ticks}}"], progress=seen.append)
    assert found.passed
    assert found.values["sim_s"] == 2.0
    assert seen[-1] == 2.0


def test_a_run_that_breaks_is_a_result(module: Callable[[str], str]) -> None:
    law = module(failing(3, "raise RuntimeError('no')"))
    found = run("paper", set={"controller": f"{law}:Law", "duration": "1 s"})
    assert found.status is Status.BROKEN
    assert "no" in found.reason
    assert found.values["sim_s"] < 1.0


def test_changes_are_read_as_options_are() -> None:
    found = override_texts({"seed": 3, "network.links.*.loss": "30 %", "checks": {"ledger": {}}})
    assert found == ["seed=3", "network.links.*.loss=30 %", 'checks={"ledger": {}}']
    wrong: list[dict[str, Any]] = [{"net": "* loss 30 %"}, {"set": "duration=3 s"}, {"set": {"duration": 3}}]
    check_refusals("execution/arguments of run", lambda given: run("paper", **given), wrong)


def test_the_package_offers_it() -> None:
    assert fleet.run is run
    assert isinstance(run(small()), fleet.Result)
