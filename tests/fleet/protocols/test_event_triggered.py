"""The formation that talks when it has news: when it sends, what it tells, what it refuses."""

from __future__ import annotations

from itertools import pairwise
from math import dist
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from protocol_network import delivery
from small_scenario import small

from agents.api import Delivery, FormationAgent, Nav, Vec3, pack
from agents.codecs import FullCodec
from agents.neighbours import NeighbourTable
from agents.payload import decode
from fleet.protocols.event_triggered import EventTriggered

ROUND = 5  # ticks of 10 ms
TURNING = (
    "reference={shape: lawn-mower, start: 0 0 5 m, heading: 0 deg, leg: 2 m, legs: 3, spacing: 1 m, speed: 0.7 m/s}",
    "guidance.rho_lo=-1.8 -1.5 -1.25 m/s",
)


def config(extrapolate: str = "neighbour", *more: str) -> Any:
    return small(f"neighbours.extrapolate={extrapolate}", *more).agent_config(1)


def nav(tick: int, x: float = 0.0, u: float = 0.5) -> Nav:
    return Nav(0, tick, (x, 0.0, 5.0, 0.0, 0.0), (u, 0.0, 0.0, 0.0, 0.0))


def sending(agent: EventTriggered, *states: Nav) -> list[int]:
    """The ticks at which it sends."""
    return [state.tick for state in states if agent.transmit(state)]


def straight(rounds: int, speed: float = 0.5, told: float = 0.5) -> list[Nav]:
    """On a straight course, with the velocity that it tells."""
    return [nav(k * ROUND, speed * k * ROUND / 100, told) for k in range(rounds)]


def test_on_a_straight_course_it_is_silent_for_as_long_as_it_may() -> None:
    agent = EventTriggered(config(), threshold_m=0.1, silence_s=2.0)
    assert sending(agent, *straight(101)) == [0, 200, 400]


def test_without_a_threshold_it_always_sends() -> None:
    """To the bytes of the agent that ships, where it deviates at all."""
    agent, plain = EventTriggered(config(), threshold_m=0.0), FormationAgent(config())
    for state in straight(20, speed=0.6):
        assert agent.transmit(state) == plain.transmit(state)


@pytest.mark.parametrize(
    ("extrapolate", "speed", "first"),
    [
        ("neighbour", 0.7, 55),  # 0.2 m/s off what it told: more than 0.1 m after 0.5 s
        ("hold", 0.5, 25),  # neighbours believe that it stays where it was
        ("reference", 0.5, None),  # the reference moves with 0.5 m/s
        ("reference", 0.7, 55),
    ],
)
def test_it_speaks_up_when_neighbours_would_be_wrong(extrapolate: str, speed: float, first: int | None) -> None:
    agent = EventTriggered(config(extrapolate), threshold_m=0.1, ahead_s=0.0)
    assert sending(agent, *straight(12, speed))[:2] == [0, *([] if first is None else [first])]


def test_along_a_reference_that_turns_it_has_no_news() -> None:
    """Neighbours that know the reference turn with it, from wherever it spoke last."""
    made = config("reference", *TURNING)
    agent = EventTriggered(made, threshold_m=0.01, silence_s=2.0, ahead_s=0.0)
    places = {tick: made.desired(tick / 100).position for tick in range(100, 600, ROUND)}
    states = [Nav(0, tick, (*place, 0.0, 0.0), (0.5, 0.0, 0.0, 0.0, 0.0)) for tick, place in places.items()]
    assert sending(agent, *states) == [100, 300, 500]


def test_what_it_compares_is_what_it_tells_also_where_there_is_roll() -> None:
    agent = EventTriggered(config())
    (payload,) = agent.transmit(Nav(0, 0, (0.0, 0.0, 5.0, 0.0, 0.0), (0.5, 0.0, 0.3, 0.0, 0.0), (0.5, 0.0)))
    told = decode(payload)
    assert told.velocity[1] < -0.1
    assert agent._told == (0, (told.position, told.velocity))


@given(
    extrapolate=st.sampled_from(["neighbour", "hold", "reference"]),
    more=st.sampled_from([(), ("neighbours.age_cap=200 ms",), TURNING]),
    threshold=st.floats(0.0, 0.5),
    ahead=st.sampled_from([0.0, 1.0, 3.0]),
    pushes=st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 3), min_size=10, max_size=60),
)
def test_in_each_round_who_heard_what_was_sent_is_off_by_the_threshold_at_most(
    extrapolate: str, more: tuple[str, ...], threshold: float, ahead: float, pushes: list[Vec3]
) -> None:
    """However the vehicle is pushed about; and there is a round at least from one message to the next."""
    scenario = small(f"neighbours.extrapolate={extrapolate}", *more)
    agent = EventTriggered(scenario.agent_config(1), threshold, ahead_s=ahead)
    table = NeighbourTable(scenario.agent_config(2), FullCodec())
    place, velocity, sent = (0.0, 0.0, 5.0), (0.5, 0.0, 0.0), []
    for k, push in enumerate(pushes):
        now = k * ROUND
        payloads = agent.transmit(Nav(0, now, (*place, 0.0, 0.0), (*velocity, 0.0, 0.0)))
        sent += [now] * len(payloads)
        table.absorb([Delivery(now, now, 1, 0, 0, payload) for payload in payloads], now)
        (believed,) = [heard.position for heard in table.states_at(now) if heard.id == 1]
        assert dist(believed, place) <= threshold + 1e-9
        velocity = tuple(v + a * ROUND / 100 for v, a in zip(velocity, push, strict=True))  # type: ignore[assignment]
        place = tuple(p + v * ROUND / 100 for p, v in zip(place, velocity, strict=True))  # type: ignore[assignment]
    assert all(b - a >= ROUND for a, b in pairwise(sent))


def test_a_new_velocity_is_news_at_once() -> None:
    agent = EventTriggered(config(), threshold_m=0.1, ahead_s=1.0)
    assert sending(agent, nav(0), nav(5, 0.025, u=0.55), nav(10, 0.05, u=0.65)) == [0, 10]


def test_what_is_older_than_the_cap_is_extrapolated_no_further() -> None:
    agent = EventTriggered(config("neighbour", "neighbours.age_cap=200 ms"), threshold_m=0.1, silence_s=10.0)
    assert sending(agent, *straight(12)) == [0, 45]  # it has stood still for neighbours since 20, and is 0.125 m off


def test_it_counts_what_it_says_and_keeps_to_itself() -> None:
    agent = EventTriggered(config(), threshold_m=0.1)
    for state in straight(10):
        agent.transmit(state)
    _, told = agent.decide(nav(46, 0.23), [])
    assert (told["sent"], told["unsaid"]) == (1.0, 9.0)
    assert told["deviation"] == pytest.approx(0.0, abs=1e-12)


def test_a_state_that_does_not_fit_the_compact_payload_is_not_counted_as_told() -> None:
    agent = EventTriggered(config("neighbour", "network.payload=compact"), threshold_m=0.1)
    assert sending(agent, nav(0, 1e6), nav(5, 0.0)) == [5]


def state_of(i: int, x: float) -> bytes:
    (payload,) = FormationAgent(small().agent_config(i)).transmit(nav(0, x))
    return payload


def test_bad_payloads_are_refused_and_those_of_other_protocols_passed_over() -> None:
    agent = EventTriggered(config())
    good = state_of(2, 5.0)
    _, told = agent.decide(nav(0), [delivery(pack("another", [1.0]))])
    assert (told["payloads_rejected"], told["neighbours_heard"]) == (0.0, 0.0)
    damaged = good[:20] + bytes([good[20] ^ 1]) + good[21:]
    forged = delivery(good, src=3)  # a neighbour that names another one as the sender
    _, told = agent.decide(nav(1), [delivery(damaged), delivery(b"noise"), forged])
    assert (told["payloads_rejected"], told["neighbours_heard"]) == (3.0, 0.0)
    _, told = agent.decide(nav(2), [delivery(good)])
    assert told["neighbours_heard"] == 1.0


def test_a_neighbour_that_lies_about_its_place_is_followed() -> None:
    """Nothing tells it from one that is there."""
    honest, deceived = EventTriggered(config()), EventTriggered(config())
    one, _ = honest.decide(nav(0), [delivery(state_of(2, 0.0))])
    other, _ = deceived.decide(nav(0), [delivery(state_of(2, 500.0))])
    assert one != other
