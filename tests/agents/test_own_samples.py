"""What a law is given by an agent whose clock differs; the law is replaced, which compiled cores do not allow."""

from __future__ import annotations

from typing import Any

from small_scenario import small

from agents.agent import Agent
from agents.payload import StateMessage, decode, encode
from agents.signals import HEARD
from netem.wire.messages import Delivery, Nav


def nav(tick: int, ahead_ms: float) -> Nav:
    return Nav(
        0, tick, (1.0, 2.0, 3.0, 0.1, 0.2), (0.5, 0.0, 0.0, 0.0, 0.0), (), tick * 10_000_000 + round(ahead_ms * 1e6)
    )


def state(sent: int) -> bytes:
    return encode(StateMessage(1, sent, (0.0, 1.0, 2.0), (0.5, 0.0, 0.0)))


def test_stamps_ages_and_time_are_those_of_the_clock() -> None:
    agent = Agent(small("neighbours={extrapolate: neighbour, drop_after: 1 s}").agent_config(2))
    (payload,) = agent.transmit(nav(100, 370.0))
    assert decode(payload).sent_tick == 137
    samples: list[Any] = []
    telemetry = (0.0,) * (agent.layout.size - sum(signal.width for signal in HEARD))

    def step(sample: Any) -> Any:
        samples.append(sample)
        return (0.0, 0.0, 0.0), telemetry

    agent._controller.step = step  # type: ignore[union-attr,method-assign]
    seen = []
    for tick, ahead_ms, sent in ((100, 370.0, 97), (101, -500.0, 98), (102, -500.0, 150), (103, 2000.0, 151)):
        agent.decide(nav(tick, ahead_ms), [Delivery(tick, 0, 1, tick, 0, state(sent))])
        sample = samples[-1]
        seen.append((sample.tick, round(sample.t, 9), sample.dt, [n.age for n in sample.neighbours]))
    # Of the last sample the newest state is too old by its clock; a state of a clock that is ahead is new, not younger.
    assert seen == [(100, 1.37, 0.01, [0.4]), (101, 0.51, 0.01, [0.0]), (102, 0.52, 0.01, [0.0]), (103, 3.03, 0.01, [])]
