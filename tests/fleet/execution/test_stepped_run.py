"""A run that is granted tick by tick is the run that goes through at once, and can be looked at and disturbed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from failing_laws import failing
from failing_laws import module as module
from notebook_pages import run_page
from refusals import check_refusals
from repository import ROOT
from small_scenario import small

import fleet
from fleet.execution.stepped_run import Run
from fleet.execution.whole_run import run as run_once
from fleet.mcap.reader import digest
from fleet.repeat.verify import verify
from fleet.result.result import Result, Status

CHANGES = {"network.links.*.loss": "30 %", "faults": [{"at": "200 ms", "kill": 3, "for": "300 ms"}]}


def without_wall(result: Result) -> dict[str, object]:
    return {key: value for key, value in result.values.items() if key not in ("wall", "log_bytes")}


@pytest.mark.parametrize("by", [1, 7, "50 ms", 1000])
def test_however_it_is_stepped_it_is_the_same_run(by: int | str, tmp_path: Path) -> None:
    log = tmp_path / "steps.mcap"
    with Run(small(), set=CHANGES, log=log) as run:
        while not run.over:
            run.step(by)
    assert without_wall(run.result) == without_wall(run_once(small(), set=CHANGES))
    assert digest(log) == run.result.digest
    assert run.t == 1.0


def test_a_run_may_go_on_to_its_end_after_some_steps() -> None:
    with Run(small(), set=CHANGES) as run:
        run.step("300 ms")
        assert without_wall(run.to_end()) == without_wall(run_once(small(), set=CHANGES))
        assert run.to_end() is run.result


def test_a_state_has_the_truth_and_what_agents_were_told() -> None:
    with Run(small(), set={"navigation": {"grade": "mems"}}) as run:
        before = run.state
        assert (before.tick, before.t, before.vehicles[1].told) == (0, 0.0, None)
        state = run.step("20 ms")
        assert (state.tick, state.t) == (2, 0.02)
        one = state.vehicles[1]
        assert one.told is not None
        assert one.told.tick == 1
        assert one.told.eta != one.eta
        assert one.told.belief
        assert "<caption>t = 0.02 s</caption>" in state._repr_html_()


def test_faults_begin_with_the_next_tick_and_the_log_has_them(tmp_path: Path) -> None:
    log = tmp_path / "steps.mcap"
    with Run(small(), log=log) as run:
        run.step("100 ms")
        assert run.inject("down 1<->2 for 200 ms") == "live-1"
        assert run.inject("kill 3") == "live-2"
        assert run.state.faults == ("live-1", "live-2")
        run.step(20)
        assert run.state.faults == ("live-2",)
        assert not run.state.vehicles[3].alive
        assert run.heal() == ["live-2"]
        run.step(6)
        assert run.state.vehicles[3].alive
        run.inject("noise vehicles=2 position_noise=10cm")
        result = run.to_end()
    assert [(one.at_s, one.fault, one.action) for one in result.faults] == [
        (0.1, "live-1", "begins"), (0.1, "live-2", "begins"), (0.3, "live-1", "ends"), (0.3, "live-2", "ends"),
        (0.36, "live-3", "begins"), (1.0, "live-3", "ends"),
    ]  # fmt: skip
    found = verify(log)
    assert found.difference is None
    assert found.messages == result.messages


def test_what_is_wrong_is_said_and_the_run_goes_on() -> None:
    def call(name: str, *given: Any) -> None:
        found = getattr(run, name)
        found(*given)

    with Run(small()) as run:
        steps = [("step", by) for by in (0, -1, "15 ms", "0 s", 2.5, "soon")]
        others = [("inject", "down 1<->3"), ("heal", "x"), ("margin", "speed"), ("result",)]
        check_refusals("execution/calls of a run", call, [*steps, *others])
        assert run.to_end().sim_s == 1.0
        check_refusals("execution/calls of one that is over", call, [("step",), ("inject", "mute 2"), ("heal",)])
    with pytest.raises(TypeError, match=r"Run\(\) has no argument 'duration'; .*set=\{'duration': '5 s'\}"):
        fleet.Run("paper", duration="5 s")  # type: ignore[arg-type]


def test_a_run_that_is_left_early_is_interrupted_and_its_log_is_whole(tmp_path: Path) -> None:
    log = tmp_path / "steps.mcap"
    with Run(small(), log=log) as run:
        run.step("300 ms")
    assert run.result.status is Status.INTERRUPTED
    assert run.result.reason == "it was closed at t = 0.3 of 1 s"
    assert digest(log) == run.result.digest
    assert verify(log).difference is None


def test_a_run_that_breaks_is_over_and_the_result_says_why(module) -> None:  # type: ignore[no-untyped-def]
    law = module(failing(3, "raise RuntimeError('no')"))
    with Run("paper", set={"controller": f"{law}:Law", "duration": "1 s"}) as run:
        while not run.over:
            run.step()
    assert run.result.status is Status.BROKEN
    assert "no" in run.result.reason
    assert run.t < 1.0


@pytest.mark.once
def test_the_page_shows_what_its_code_prints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_page(ROOT / "docs" / "guide" / "stepping.md") >= 5
