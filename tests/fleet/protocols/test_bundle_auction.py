"""The auction of places as a whole agent: what it says, believes, refuses, and takes from the silent."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
from protocol_network import ROUND_TICKS, ProtocolNetwork, delivery, line, nav, ring, stand_still
from refusals import check_refusals
from small_scenario import small

from agents.api import Nav, pack, unpack
from fleet.checks.api import Facts
from fleet.protocols.bundle_auction import KIND, BundleAuction
from fleet.protocols.checks import AgreeAfterHeal, AtMostOneLeader, NoConflict
from fleet.protocols.election import Election
from fleet.protocols.event_triggered import EventTriggered

pytestmark = pytest.mark.usefixtures("stand_still")
__all__ = ["stand_still"]
SCENARIO = small("vehicles=4")
PLACES = [[20.0, 0.0, 5.0], [30.0, 0.0, 5.0], [0.0, 40.0, 5.0], [0.0, 50.0, 5.0]]


def agent(i: int = 1, **parameters: Any) -> BundleAuction:
    return BundleAuction(SCENARIO.agent_config(i), **{"places": PLACES, "bundle": 2, **parameters})


def claims(net: ProtocolNetwork) -> list[int]:
    """Which places are claimed, each as often as there are vehicles that do."""
    return sorted(j for i, winners in net.values("winner").items() for j, winner in enumerate(winners) if winner == i)


def message(bid: float = 0.5, winner: int = 2, sent: int = 10, **changes: Any) -> list[Any]:
    values = {"bids": [bid] * 4, "winners": [winner] * 4, "heard": [[2, sent]], "done": [], **changes}
    return list(values.values())


def heard(values: Any, kind: str = KIND) -> dict[str, Any]:
    """What it reports after a message from vehicle 2, sent at tick 10."""
    one = agent()
    one.decide(nav(0), [])
    _, told = one.decide(nav(11), [delivery(pack(kind, values), sent=10)])
    return dict(told)


@pytest.mark.parametrize("links", [ring(4), line(1, 2, 3, 4), line(3, 1, 4, 2)])
@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_all_places_are_claimed_once(links: Any, loss: float) -> None:
    net = ProtocolNetwork(agent, links)
    net.run(49, loss=loss, delay=(1, 40), repeat=0.2)
    assert claims(net) == [0, 1, 2, 3]


def test_who_is_silent_loses_its_places() -> None:
    net = ProtocolNetwork(lambda i: agent(i, silence_s=1.0), ring(4))
    net.run(12)
    taken = set(claims(net))
    (gone, lost), *_ = ((i, set(w)) for i, w in net.values("winner").items() if i in w)
    assert gone in lost
    net.kill(gone)
    net.run(9)
    assert set(claims(net)) < taken
    net.run(12)
    assert claims(net) == [0, 1, 2, 3]
    assert all(told["released"] == 1.0 for told in net.told.values())


def test_an_agent_that_joins_late_learns_who_has_what() -> None:
    net = ProtocolNetwork(agent, ring(4))
    net.kill(4)
    net.run(12)
    net.start(4)
    net.run(12)
    assert claims(net) == [0, 1, 2, 3]
    assert len({tuple(winners) for winners in net.values("winner").values()}) == 1


def test_what_is_visited_is_nobodys_any_more() -> None:
    one, two = agent(1), agent(2)
    one.decide(nav(0), [])
    there = Nav(0, 1, (*PLACES[0], 0.0, 0.0), (0.0,) * 5)
    _, told = one.decide(there, [])
    assert (told["done"], told["winner"][0]) == (1.0, 0.0)
    *_, payload = one.transmit(nav(10))
    assert unpack(KIND, payload)[3] == [0]
    _, told = two.decide(nav(11), [delivery(payload, src=1, sent=10)])
    assert (told["done"], told["winner"][0]) == (1.0, 0.0)


def test_a_place_where_it_is_already_is_visited() -> None:
    one = agent(places=[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [9.0, 0.0, 0.0]], bundle=3)
    told = [one.decide(nav(tick), [])[1] for tick in range(4)]
    assert [each["done"] for each in told] == [0.0, 1.0, 2.0, 2.0]
    assert [each["target"] for each in told][2:] == [3.0, 3.0]


def test_a_message_is_believed() -> None:
    told = heard(message(bid=0.999))
    assert list(told["winner"])[:4] == [2.0] * 4
    assert told["refused"] == 0.0


@pytest.mark.parametrize(
    "values",
    [
        message(bid=1.5),  # more than any place is worth: a lie
        message(bid=-0.1),
        message(winner=-1),
        message(winner=1001),  # there is no such vehicle, and what is remembered must not grow without end
        message(heard=[[2, 10], [1001, 10]]),
        message(winners=[2, 2, 2]),
        message(bids=[0.5, 0.5, 0.5, "x"]),
        message(bids=[True] * 4),
        message(heard=[[2, 11]]),  # from the future
        message(heard=[[2, 10], [3, 1000]]),
        message(heard=[[3, 10]]),  # the sender is another one
        message(heard=[[2, 10, 10]]),
        message(heard=7),
        message(done=[4]),
        message(done=[-1]),
        [],
        None,
        {"bids": []},
    ],
)
def test_what_no_honest_neighbour_says_is_refused(values: Any) -> None:
    told = heard(values)
    assert told["refused"] == 1.0
    assert sorted(list(told["winner"])[:4]) == [0.0, 0.0, 1.0, 1.0]


def test_payloads_of_others_are_passed_over_and_damaged_ones_counted() -> None:
    assert heard([1.0], kind="another")["refused"] == 0.0
    one = agent()
    good = pack(KIND, message())
    damaged = [good[:-1] + bytes([good[-1] ^ 1]), good[:40]]
    _, told = one.decide(nav(11), [delivery(payload, sent=10) for payload in [*damaged, b"", b"\x01noise"]])
    assert told["refused"] == 2.0


def test_a_possible_lie_is_believed_and_the_places_wait() -> None:
    """Who wins all places at the highest bid and goes nowhere: nothing tells it from an honest one."""
    told = heard(message(bid=1.0))
    assert (told["claimed"], told["target"]) == (0.0, 0.0)


def test_parameters_that_make_no_sense_are_refused() -> None:
    """Also those of the other protocols and of their checks."""
    nan, inf = float("nan"), float("inf")
    no_places: list[dict[str, Any]] = [{"places": each} for each in ([], [[1.0, 2.0]], [[1.0, 2.0, nan]])]
    odd = [{"bundle": 0}, {"bundle": 2.5}, {"speed_mps": 0.0}, {"silence_s": inf}, {"discount": 1.0}]
    check_refusals("protocols/auction", lambda given: agent(**given), [*no_places, *odd])
    odd = [{"threshold_m": -0.1}, {"threshold_m": nan}, {"silence_s": 0.0}, {"ahead_s": -1.0}]
    event_triggered = partial(EventTriggered, SCENARIO.agent_config(1))
    check_refusals("protocols/event triggered", lambda given: event_triggered(**given), odd)
    voters: list[dict[str, Any]] = [{"vehicles": 3}, {"vehicles": 4, "quorum": "most"}]
    check_refusals("protocols/election", lambda given: Election(SCENARIO.agent_config(4), **given), voters)
    facts = Facts("three", 1, 3, 10.0, 0.1, 0.0, ((2, 1), (2, 3), (3, 2)), {})
    checks: list[tuple[type[Any], dict[str, Any]]] = [
        (AtMostOneLeader, {"per": "x"}), (AgreeAfterHeal, {"within": "1 s", "quorum": "x"}),
        (NoConflict, {"places": PLACES, "bundle": 2}),  # there is no way from each to all
    ]  # fmt: skip
    check_refusals("protocols/checks", lambda check, given: check(facts, **given), checks)


def test_a_message_of_the_largest_auction_fits_into_a_round() -> None:
    """32 places and news of a thousand vehicles are less than the 40 kB of a round."""
    one = agent(places=[[float(j), 0.0, 5.0] for j in range(32)], bundle=32)
    one.decide(nav(0), [])
    everyone = [[m, 10**7] for m in range(2, 1001)]
    values = [[0.5] * 32, [2] * 32, everyone, []]
    one.decide(nav(10**7 + 1), [delivery(pack(KIND, values), sent=10**7)])
    (payload,) = one.transmit(nav(10**7 + ROUND_TICKS))
    assert 8_000 < len(payload) < 40_000
