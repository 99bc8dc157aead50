"""Nothing of the truth reaches an agent: methods of the cores are replaced, which compiled ones do not allow."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from agents.agent import Agent
from agents.payload import decode as decode_payload
from fleet.execution.judged import run
from fleet.scenario.loading import load_scenario
from netem.wire.messages import Delivery, Nav
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
