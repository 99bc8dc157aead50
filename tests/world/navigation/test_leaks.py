"""Nothing of the truth reaches an agent: methods of the cores are replaced, which compiled ones do not allow."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest

from agents.agent import Agent
from agents.payload import decode as decode_payload
from fleet.execution.whole_run import run
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Delivery, Nav
from world.run_state import RunState
from world.sea import World

SHORT = ["duration=2 s", "checks={}", "navigation.tilt=1 deg", "faults=[{at: 500 ms, for: 1 s, fix: {lost: 50 %}}]"]


def test_no_truth_reaches_an_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every number of a nav differs from the truth of its tick, and so does every position that is sent to others."""
    told: list[tuple[int, Nav]] = []
    sent: list[Any] = []
    true: dict[tuple[int, int], tuple[float, ...]] = {}
    sense, decide, transmit = World.sense, Agent.decide, Agent.transmit

    def spied_sense(self: World, i: int) -> Any:
        eta, nu = self.state(i)
        true[i, self.tick(i)] = (*eta, *nu)
        return sense(self, i)

    def spied_decide(self: Agent, nav: Nav, deliveries: Iterable[Delivery]) -> Any:
        told.append((self.config.id, nav))
        return decide(self, nav, deliveries)

    def spied_transmit(self: Agent, nav: Nav) -> Any:
        payloads = transmit(self, nav)
        sent.extend(map(decode_payload, payloads))
        return payloads

    monkeypatch.setattr(World, "sense", spied_sense)
    monkeypatch.setattr(Agent, "decide", spied_decide)
    monkeypatch.setattr(Agent, "transmit", spied_transmit)
    run(load_scenario("dead-reckoning", SHORT))
    assert len(told) == 4 * 200
    assert len(sent) == 4 * 20
    for i, nav in told:
        assert not {*nav.eta, *nav.nu} & {*true[i, nav.tick]}
        assert len(nav.belief) == 10
    for message in sent:
        assert not {*message.position, *message.velocity} & {*true[message.sender, message.sent_tick]}


def answers(nav: Callable[[RunState, int, int, int], Nav], *overrides: str) -> tuple[list[Any], list[Any]]:
    """What each agent commands and sends at each tick of a run, and the true states at its ticks.

    Args:
        nav: in place of `RunState.nav`.
    """
    decide, transmit = Agent.decide, Agent.transmit
    said: list[Any] = []
    true: list[Any] = []

    def spied_decide(self: Agent, nav: Nav, deliveries: Iterable[Delivery]) -> Any:
        answer = decide(self, nav, deliveries)
        said.append((self.config.id, nav.tick, answer))
        return answer

    def spied_transmit(self: Agent, nav: Nav) -> Any:
        payloads = transmit(self, nav)
        said.append((self.config.id, nav.tick, payloads))
        return payloads

    def spied_nav(self: RunState, i: int, life: int, k: int) -> Nav:
        true.append(self.world.state(i))
        return nav(self, i, life, k)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RunState, "nav", spied_nav)
        patch.setattr(Agent, "decide", spied_decide)
        patch.setattr(Agent, "transmit", spied_transmit)
        run(load_scenario("dead-reckoning", [*SHORT, *overrides]))
    return said, true


def test_agents_that_believe_the_same_do_the_same_in_another_sea() -> None:
    """Vehicles that begin elsewhere and drift with a current, and are told what those of the first run believed, have
    agents that command and send the same to the last bit: nothing of the truth reaches them by another way."""
    believed: dict[tuple[int, int], Nav] = {}
    original = RunState.nav

    def kept(self: RunState, i: int, life: int, k: int) -> Nav:
        return believed.setdefault((i, k), original(self, i, life, k))

    def again(self: RunState, i: int, life: int, k: int) -> Nav:
        return believed[i, k]

    said, true = answers(kept)
    other, elsewhere = answers(again, "sea={current: 0.3 -0.2 0.1 m/s}", "initial.scatter=2 m")
    assert not {state for state, _ in true} & {state for state, _ in elsewhere}
    assert len(said) == 4 * (200 + 20)
    assert other == said
