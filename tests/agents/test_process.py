"""How an agent gets ready: by probes that become rarer."""

from __future__ import annotations

import pytest
from nowhere import Nowhere
from small_scenario import small

import agents.process
from agents.loop import AgentLoop
from agents.make_agent import make_agent
from agents.process import READY_TIMEOUT_S, AgentProcess
from netem.errors import BusError
from netem.wire.keys import Keys

KEYS = Keys("0a6e")


def test_an_agent_without_an_answer_asks_ever_more_rarely(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand agents that asked every 20 ms until the last one was there filled all queues of the router."""
    now, looks = 0.0, 0

    def pass_time(seconds: float) -> None:
        nonlocal now, looks
        now += seconds
        looks += 1

    monkeypatch.setattr(agents.process, "monotonic", lambda: now)
    monkeypatch.setattr(agents.process, "sleep", pass_time)
    config = small().agent_config(1)
    bus = Nowhere()
    process = AgentProcess(bus, KEYS, 1, AgentLoop(make_agent(config), config.round_ticks))  # type: ignore[arg-type]
    with pytest.raises(BusError, match="no answer from world and netem within 30 s"):
        process.get_ready()
    probes = [key for key, _ in bus.put if key == KEYS.tx(1)]
    assert 5 < len(probes) < 15
    assert looks < 500
    assert READY_TIMEOUT_S <= now < READY_TIMEOUT_S + 2.0
