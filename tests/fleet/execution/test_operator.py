"""What an operator is told when a request is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock

import pytest
from small_scenario import small

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
