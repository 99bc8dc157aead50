"""What an operator is told when a request is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from refusals import CommandRefused, check_refusals
from small_scenario import small

from fleet.execution import operator as module
from fleet.execution.clock import GrantPolicy, LiveClock
from fleet.execution.operator import Operator
from fleet.recorder.journal import Journal
from fleet.scenario.scenario import Scenario


def operator_of(scenario: Scenario, fleet: Any) -> Operator:
    clock = LiveClock(GrantPolicy(scenario.ticks, scenario.tick_ns, scenario.round_ticks, 1, None), 0.0)
    return Operator(scenario, Journal(scenario, MagicMock()), clock, fleet)


def test_a_refusal_says_what_to_do() -> None:
    operator = operator_of(small(), SimpleNamespace(granted=3))

    def inject(fault: dict[str, Any]) -> None:
        answer = operator.handle({"op": "inject", "fault": fault})
        if "error" in answer:
            raise CommandRefused(answer["status"], answer["error"])

    texts = ("los 20%", "delay 20", "loss 3% seed 7")
    links: list[dict[str, Any]] = [*({"link": {"1->2": text}} for text in texts), {"link": {"1->3": "loss 3%"}}]
    others = [{"kill": 9}, {"at": "3 s", "kill": 3}, {"partition": "half"}, {"mute": 1, "for": "5ms"}]
    check_refusals("execution/faults of an operator", inject, [*links, *others])


def test_checks_are_not_judged_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """However often pages ask: the run goes on meanwhile."""
    scenario = small("checks={formation_error: {below: 1 m, after: 500 ms}}")
    operator = operator_of(scenario, SimpleNamespace(granted=3))
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


class Healed:
    """An operator of a run of 300 ticks, 10 to a round, and what it told the fleet."""

    def __init__(self, granted: int, *faults: str) -> None:
        scenario = small("duration=3 s", "network.period=100 ms", f"faults=[{', '.join(faults)}]")
        self.fleet = MagicMock(granted=granted)
        self.operator = operator_of(scenario, self.fleet)

    def heal(self, name: Any = None) -> dict[str, Any]:
        return self.operator.handle({"op": "heal", "id": name})

    def ends(self) -> dict[str, int | None]:
        return {part.id: part.end for part in self.operator.faults}

    def restarts(self) -> list[Any]:
        return [call.args for call in self.fleet.restart_agent.call_args_list]


DOWN, MUTE, KILL = "{id: d, at: 1 s, down: 1->2}", "{id: m, at: 1 s, mute: 2}", "{id: k, at: 1 s, kill: 3}"


def test_a_fault_that_is_healed_ends_at_once_and_the_others_go_on() -> None:
    run = Healed(153, DOWN, MUTE)
    assert run.heal("m") == {"healed": ["m"], "at_s": 1.53}
    assert run.ends() == {"d": None, "m": 153}
    assert run.heal("m")["error"] == "there is no active fault 'm'; active: d"
    assert run.heal(7)["error"] == "expected the id of a fault, or none for all of them"


@pytest.mark.parametrize(("granted", "begins"), [(153, 160), (160, 160), (101, 110), (100, 110)])
def test_an_agent_that_was_killed_begins_again_with_a_round(granted: int, begins: int) -> None:
    """Not in the round with which the kill begins: its process may have been ended already."""
    run = Healed(granted, DOWN, KILL)
    assert run.heal() == {"healed": ["d", "k"], "at_s": begins / 100}
    assert run.ends() == {"d": granted, "k": begins}
    assert run.restarts() == [(3, 100, begins)]


@pytest.mark.parametrize(("kill", "granted"), [("1 s", 291), ("2900 ms", 290)])
def test_without_a_round_left_all_but_agents_are_healed(kill: str, granted: int) -> None:
    run = Healed(granted, DOWN, f"{{id: k, at: {kill}, kill: 3}}")
    assert run.heal() == {"healed": ["d"], "at_s": granted / 100}
    assert run.ends() == {"d": granted, "k": None}
    assert run.heal("k")["error"] == "the run ends before the next round, so no agent can begin again"
    assert run.restarts() == []
