"""Agents go by the clock of their vehicle, and sample with simulated time."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenario import small

from agents import compact
from agents.agent import Agent
from agents.formation_agent import FormationAgent
from agents.neighbours import AHEAD_S
from agents.own_time import OwnNav, deliveries_to_own_clock, to_own_clock, to_simulated_time
from agents.payload import StateMessage, encode
from fleet.scenario.scenario import Scenario
from netem.wire.messages import Delivery, Nav

ETA, NU = (1.0, 2.0, 3.0, 0.1, 0.2), (0.5, 0.0, 0.0, 0.0, 0.0)


def nav(tick: int, ahead_ms: float | None = None) -> Nav:
    return Nav(0, tick, ETA, NU, (), None if ahead_ms is None else tick * 10_000_000 + round(ahead_ms * 1e6))


def state(sent: int) -> bytes:
    return encode(StateMessage(1, sent, (0.0, 1.0, 2.0), (0.5, 0.0, 0.0)))


def test_a_right_clock_changes_nothing() -> None:
    """To the last bit, so a clock fault that is still to come, or injected later, is not seen before it begins."""
    for overrides in ([], ["network.payload=compact"], ["controller=bsmc", "neighbours.extrapolate=reference"]):
        plain, told = (Agent(small(*overrides).agent_config(2)) for _ in range(2))
        for tick in range(0, 60, 5):
            heard = [Delivery(tick, max(0, tick - 5), 1, tick // 5, 0, state(max(0, tick - 5)))]
            assert plain.step(nav(tick), heard) == told.step(nav(tick, 0.0), heard)


@pytest.mark.parametrize(("ahead_s", "refused"), [(0.0, 0), (AHEAD_S, 0), (AHEAD_S + 0.1, 1)])
def test_a_state_may_come_from_a_clock_that_is_ahead(ahead_s: float, refused: int) -> None:
    """While all clocks are right nothing comes from the future."""
    late = Delivery(100, 90, 1, 0, 0, state(100 + round(ahead_s * 100)))
    for told, expected in ((nav(100, 0.0), refused), (nav(100), int(ahead_s > 0.0))):
        agent = Agent(small().agent_config(2))
        agent.decide(told, [late])
        assert agent.counters()["from_future"] == expected


@given(st.integers(0, 10**6), st.integers(-3000, 3000), st.sampled_from([1, 5, 100]))
def test_a_compact_stamp_is_off_by_half_a_round_at_most(sent: int, ahead: int, m: int) -> None:
    """Of a clock that is ahead of the receiver's, or behind."""
    data = compact.encode(StateMessage(1, sent, (0.0,) * 3, (0.0,) * 3), m)
    now = max(0, sent - ahead)
    found = compact.decode(data, now, m, 4000)
    span = compact.ROUNDS * m
    off = (found.sent_tick - sent + span // 2) % span - span // 2
    assert abs(off) <= m / 2
    if span // 2 >= 4000 and abs(ahead) + m < min(4000, span - 4000 - 2 * m) and now > 0:
        assert abs(found.sent_tick - sent) <= m / 2


def test_a_whole_agent_gets_its_own_ticks_and_the_formation_keeps_its_samples() -> None:
    """A clock that stands still, or is set back, gives the same tick twice; the formation's laws do not mind."""
    scenario: Scenario = small()
    formation, plain = (FormationAgent(scenario.agent_config(2)) for _ in range(2))
    ticks = []
    for tick, ahead_ms in ((0, -5.0), (1, -11.0), (2, -20.0), (3, 50.0), (4, 0.0)):
        sent = nav(tick, max(ahead_ms, -10.0 * tick))
        own = to_own_clock(sent, 10_000_000)
        assert isinstance(own, OwnNav) and to_simulated_time(own) == sent
        ticks.append(own.tick)
        tau, told = formation.decide(own, [])
        again, _ = plain.decide(sent, [])
        assert tau == again and told["neighbours_heard"] == 0
    assert ticks == [0, 0, 0, 8, 4]
    assert min(b - a for a, b in pairwise(ticks)) < 0
    assert to_own_clock(nav(3), 10_000_000) is not None and not isinstance(to_own_clock(nav(3), 1), OwnNav)
    due = Delivery(2, 77, 1, 0, 0, b"")
    assert deliveries_to_own_clock([due], to_own_clock(nav(3, 50.0), 10_000_000)) == [Delivery(7, 77, 1, 0, 0, b"")]


def test_a_range_comes_with_the_state_it_was_measured_with_and_stays_with_it() -> None:
    """It is part of the memory, and a newer state without a range has none."""
    agent = Agent(small().agent_config(2))
    ranged = Delivery(10, 9, 1, 0, 0, state(9), 12.5, 0.5, 8)
    agent.decide(nav(10), [ranged])
    (heard,) = agent._neighbours.states_at(11)
    assert (heard.range_m, heard.range_sd_m) == (12.5, 0.5)
    agent.decide(nav(20), [Delivery(20, 19, 1, 1, 0, state(19))])
    assert agent._neighbours.states_at(21)[0].range_m is None
    shown = to_own_clock(nav(10, 50.0), 10_000_000)
    assert deliveries_to_own_clock([ranged], shown)[0].range_tick == 13
