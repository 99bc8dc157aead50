"""What an operator is told when a request is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock

import pytest
from small_scenario import small

from fleet.execution import operator as module
from fleet.execution.clock import Clock, LiveClock
from fleet.execution.fleet import Fleet
from fleet.execution.operator import Operator
from fleet.recorder.journal import Journal


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"link": {"1->2": "los 20%"}}, 'link.1->2: unknown link condition "los"; did you mean "loss"?'),
        (
            {"link": {"1->2": "delay 20"}},
            'link.1->2: the delay "20" has no unit; write "20ms", or "20us", which is how ',
        ),
        ({"kill": 9}, "kill: there is no vehicle 9: they are 1 to 3"),
        ({"at": "3 s", "kill": 3}, "expected a fault without at: it begins now"),
    ],
)
def test_a_refusal_says_what_to_do(fault: dict[str, Any], said: str) -> None:
    scenario = small()
    clock = LiveClock(Clock(scenario.ticks, scenario.tick_ns, scenario.round_ticks, 1, None), 0.0)
    fleet = cast("Fleet", SimpleNamespace(granted=3))
    operator = Operator(scenario, Journal(scenario, MagicMock()), clock, fleet)
    answer = operator.handle({"op": "inject", "fault": fault})
    assert answer["status"] == 2
    assert answer["error"].startswith(said)


def test_checks_are_not_judged_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """However often pages ask: the run goes on meanwhile."""
    scenario = small("checks={formation_error: {below: 1 m, after: 500 ms}}")
    clock = LiveClock(Clock(scenario.ticks, scenario.tick_ns, scenario.round_ticks, 1, None), 0.0)
    operator = Operator(scenario, Journal(scenario, MagicMock()), clock, cast("Fleet", SimpleNamespace(granted=3)))
    first = operator.handle({"op": "checks"})["checks"]
    assert first[0]["check"] == "formation_error" and first[0]["passed"] is None
    judged = MagicMock(return_value=[])
    monkeypatch.setattr(module, "standing", judged)
    monkeypatch.setattr(module, "JUDGE_EVERY_S", 0.0)
    assert operator.handle({"op": "checks"})["checks"] is first
    now = iter([1e9, 1e9 + 0.5, 1e9 + 50.0, 1e9 + 50.6, 1e9 + 50.7]).__next__
    monkeypatch.setattr(module, "monotonic", now)
    for asked in (1, 1, 2):  # half a second, so not again within the next fifty
        operator.handle({"op": "checks"})
        assert judged.call_count == asked
