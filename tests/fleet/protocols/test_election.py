"""Leader election: never two leaders, whatever the network does; one per side, and agreement, within their bounds."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from protocol_network import ROUND_TICKS, ProtocolNetwork, delivery, inside, line, nav, ring, stand_still
from samples import samples
from small_scenario import small

from agents.api import pack, unpack
from fleet.protocols.election import RECORDS, Election

pytestmark = pytest.mark.usefixtures("stand_still")
__all__ = ["stand_still"]
SCENARIO = small("vehicles=5")
LEASE = 30  # rounds
GRAPHS = [ring(5), line(1, 2, 3, 4, 5), line(3, 1, 5, 2, 4)]


def network(quorum: Any = "fleet", links: Any = GRAPHS[0], seed: int = 1) -> ProtocolNetwork:
    lease_s = LEASE * ROUND_TICKS / 100
    return ProtocolNetwork(
        lambda i: Election(SCENARIO.agent_config(i), vehicles=5, lease_s=lease_s, quorum=quorum), links, seed
    )


def leaders(net: ProtocolNetwork) -> list[int]:
    return [i for i, leads in net.values("leads").items() if leads]


def agreed(net: ProtocolNetwork, leader: int, *those: int) -> bool:
    return all(net.told[i]["leader"] == leader for i in those)


def disturb(net: ProtocolNetwork, draw: Random, kinds: int) -> None:
    """Kill, start, split or join at random; with six kinds also suspend or continue an agent."""
    match draw.randrange(kinds):
        case 0 if len(net.agents) > 1:
            net.kill(draw.choice(sorted(net.agents)))
        case 1 if missing := sorted({1, 2, 3, 4, 5} - set(net.agents)):
            net.start(draw.choice(missing))
        case 2:
            one = {i for i in range(1, 6) if draw.random() < 0.5}
            net.split(one, {1, 2, 3, 4, 5} - one)
        case 3:
            net.split()
        case 4:
            net.suspended.add(draw.choice(sorted(net.agents)))
        case 5:
            net.suspended.clear()


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), links=st.sampled_from(GRAPHS), loss=st.floats(0.0, 0.8), late=st.integers(1, 500))
def test_a_quorum_of_the_fleet_never_has_two_leaders(seed: int, links: Any, loss: float, late: int) -> None:
    """Whatever is lost and however late it is, who ends and comes back, and how it is cut."""
    net, draw = network(links=links, seed=seed), Random(seed)
    for _ in range(25):
        disturb(net, draw, kinds=4)
        for _ in range(draw.randrange(LEASE)):
            net.run(1, loss=loss, delay=(1, late), repeat=0.1)
            assert len(leaders(net)) <= 1


@settings(max_examples=samples(36))
@given(seed=st.integers(0, 10**6), links=st.sampled_from(GRAPHS), quorum=st.sampled_from(["fleet", "side"]))
def test_all_agree_within_the_bound_after_any_history(seed: int, links: Any, quorum: Any) -> None:
    """Two leases and seven times what news take across, after the last change; one lease after it one leads at most."""
    spread = 8  # rounds: over four links of up to two rounds
    net, draw = network(quorum, links, seed), Random(seed)
    for _ in range(8):
        match draw.randrange(3):
            case 0 if len(net.agents) == 5:
                net.kill(draw.randint(1, 5))
            case 1 if len(net.agents) < 5:
                net.start(min({1, 2, 3, 4, 5} - set(net.agents)))
            case 2:
                one = {i for i in range(1, 6) if draw.random() < 0.5}
                net.split(one, {1, 2, 3, 4, 5} - one)
        net.run(draw.randrange(3 * LEASE), delay=(1, 20))
    net.split()
    for i in {1, 2, 3, 4, 5} - set(net.agents):
        net.start(i)
    net.run(LEASE, delay=(1, 20))
    for _ in range(LEASE + 7 * spread):
        net.run(1, delay=(1, 20))
        assert len(leaders(net)) <= 1
    (leader,) = leaders(net)
    assert agreed(net, leader, 1, 2, 3, 4, 5)
    net.run(2 * LEASE, delay=(1, 20))
    assert agreed(net, leader, 1, 2, 3, 4, 5)


def two_lead(seed: int) -> tuple[bool, bool]:
    """Whether two ever lead at once over a random schedule: by what each reported last, and by its lease as well."""
    net, draw = network(links=GRAPHS[seed % 3], seed=seed), Random(seed)
    loss, late = draw.choice([0.0, 0.2, 0.5]), draw.choice([1, 30, 100])
    believed = leased = False
    for _ in range(25):
        disturb(net, draw, kinds=6)
        for _ in range(draw.randrange(2 * LEASE)):
            now = net.tick / 100
            net.run(1, loss=loss, delay=(1, late))
            believed |= len(leaders(net)) > 1
            leased |= sum(now < until for until in net.values("leads_until").values()) > 1
    return believed, leased


@settings(max_examples=samples(40))
@given(seed=st.integers(0, 10**6))
def test_nobody_leads_by_its_lease_while_another_does_also_suspended(seed: int) -> None:
    """At any true time, over pauses, deaths, restarts and partitions."""
    assert not two_lead(seed)[1]


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_what_the_page_says_of_schedules_with_pauses() -> None:
    """The figures of docs/guide/protocols/election.md."""
    found = [two_lead(seed) for seed in range(100)]
    assert (sum(believed for believed, _ in found), sum(leased for _, leased in found)) == (16, 0)


@pytest.mark.parametrize("quorum", ["fleet", "side"])
def test_a_suspended_leader_leads_until_its_voters_are_free(quorum: str) -> None:
    """Its lease ends before another one leads, and not much before."""
    net = network(quorum)
    net.run(2 * LEASE)
    until = net.told[1]["leads_until"]
    net.suspended = {1}
    while leaders(net) == [1]:
        net.run(1)
    assert leaders(net) == [1, 2]  # by what it reported last
    assert until <= (net.tick - ROUND_TICKS) / 100 <= until + 0.5
    net.suspended = set()
    net.run(1)
    assert leaders(net) == [2]
    assert net.told[1]["leads_until"] == 0.0


@settings(max_examples=samples(40))
@given(seed=st.integers(0, 10**6), quorum=st.sampled_from(["fleet", "side"]), loss=st.floats(0.0, 0.8))
def test_a_leader_that_hears_nothing_more_leads_until_it_said(seed: int, quorum: str, loss: float) -> None:
    net = network(quorum, seed=seed)
    net.run(LEASE + seed % LEASE, loss=loss, delay=(1, 40))
    for i in leaders(net):
        agent, until = net.agents[i], round(net.told[i]["leads_until"] * 100)
        assert until > net.tick - ROUND_TICKS
        for tick in range(net.tick, until + 1):
            assert agent.decide(nav(tick), [])[1]["leads"] == (tick < until)


@pytest.mark.parametrize("quorum", ["fleet", "side"])
def test_half_of_the_voters_is_no_quorum(quorum: Any) -> None:
    """Four vehicles: two halves of the fleet, and two voters of a side of which one is free."""
    four = small("vehicles=4")
    net = ProtocolNetwork(lambda i: Election(four.agent_config(i), vehicles=4, quorum=quorum), ring(4))
    net.run(2 * LEASE)
    assert leaders(net) == [1]
    net.split([1, 2], [3, 4])
    net.run(2 * LEASE)
    assert leaders(net) == ([] if quorum == "fleet" else [1, 3])
    if quorum == "side":
        net.kill(3)
        net.start(3)
        net.run(LEASE // 2)  # it listens, so of two voters one grants
        assert net.told[4]["leader"] == 0


def test_the_lowest_number_leads_first() -> None:
    net = network()
    net.run(LEASE)
    assert leaders(net) == []  # all listen
    net.run(4)
    assert agreed(net, 1, 1, 2, 3, 4, 5)
    assert leaders(net) == [1]


@pytest.mark.parametrize("rounds", [1, 2, 4])
def test_when_the_leader_ends_another_follows_within_the_bound(rounds: int) -> None:
    """A lease, what news take across, and a round; a link takes so many rounds."""
    net = network()
    delay = (ROUND_TICKS * rounds, ROUND_TICKS * rounds)
    net.run(3 * LEASE, delay=delay)
    assert leaders(net) == [1]
    net.kill(1)
    net.run(LEASE + 3 * rounds + 1, delay=delay)  # three links from 2 to 5 are left
    assert agreed(net, 2, 2, 3, 4, 5)
    assert leaders(net) == [2]


def test_who_comes_back_or_joins_late_takes_over_nothing() -> None:
    net = network()
    net.run(1)
    net.kill(1)
    net.run(3 * LEASE)
    assert leaders(net) == [2]
    net.start(1)
    for _ in range(4 * LEASE):
        net.run(1)
        assert leaders(net) == [2]
    assert agreed(net, 2, 1, 2, 3, 4, 5)


@pytest.mark.parametrize(("quorum", "expected"), [("fleet", [3]), ("side", [1, 3])])
def test_a_side_of_less_than_half_has_a_leader_only_if_asked_for(quorum: str, expected: list[int]) -> None:
    net = network(quorum)
    net.run(2 * LEASE)
    net.split([1, 2], [3, 4, 5])
    net.run(LEASE + 6)
    assert leaders(net) == expected
    assert agreed(net, 3, 3, 4, 5)
    assert agreed(net, 1 if quorum == "side" else 0, 1, 2)
    net.split()
    net.run(4)
    assert leaders(net) == [3]  # the larger side has more than half of all
    assert agreed(net, 3, 1, 2, 3, 4, 5)


def test_who_was_started_again_grants_nothing_for_a_lease() -> None:
    """Its life before may have granted: two that hold a majority would both lead."""
    net = network()
    net.run(2 * LEASE)
    net.kill(2)
    net.start(2)
    for _ in range(LEASE):
        net.run(1)
        assert net.told[2]["candidate"] == 0
    net.run(2)
    assert net.told[2]["candidate"] == 1


def record(*, i: Any = 2, made: Any = 10, candidate: Any = 2, until: Any = 100) -> bytes:
    return pack(RECORDS, [[i, made, candidate, until]])


BAD = {
    "no list": pack(RECORDS, 7),
    "no record": pack(RECORDS, [7]),
    "a record too short": pack(RECORDS, [[2, 10, 2]]),
    "more than there are vehicles": pack(RECORDS, [[2, 10, 2, 100]] * 6),
    "a vehicle that does not exist": record(i=6),
    "vehicle nobody": record(i=0),
    "made in the future": record(made=10 + LEASE * ROUND_TICKS + 1),
    "made before the start": record(made=-1),
    "a candidate that does not exist": record(candidate=6),
    "a grant for longer than a lease": record(until=10 + 2 * LEASE * ROUND_TICKS + 1),
    "a number that is no integer": record(until=50.5),
    "a bool": record(candidate=True),
    "damaged": record()[:-1] + b"?",
}


def told_after(*payloads: bytes) -> tuple[Any, Any]:
    agent = Election(SCENARIO.agent_config(1), vehicles=5)
    _, told = agent.decide(nav(11), [delivery(payload, sent=10) for payload in payloads])
    state = inside(agent)
    del state["_refused"]
    return state, told


@pytest.mark.parametrize("case", BAD)
def test_what_makes_no_sense_is_refused_and_changes_nothing(case: str) -> None:
    state, told = told_after(BAD[case])
    assert told["refused"] == 1
    assert state == told_after()[0]


def test_the_payload_of_another_protocol_is_passed_over() -> None:
    state, told = told_after(pack("average/naive", [2, 12.0]))
    assert told["refused"] == 0
    assert state == told_after()[0]


def test_what_is_old_or_about_itself_is_passed_over() -> None:
    state, told = told_after(record(made=9), record(made=8, candidate=3), record(i=1, candidate=3))
    assert [*state["_others"]] == [2] and state["_others"][2][0] == 9
    assert told["refused"] == 0


class Liar(Election):
    """Says that all others grant to it."""

    def transmit(self, own: Any) -> list[bytes]:
        until = own.tick + LEASE * ROUND_TICKS
        return [pack(RECORDS, [[i, own.tick, 5, until] for i in range(1, 6)])]


def test_a_neighbour_that_lies_is_believed_until_it_is_gone() -> None:
    """Others take it for the leader, and grant to it. When it is silent, all that it said expires."""
    net = ProtocolNetwork(lambda i: (Liar if i == 5 else Election)(SCENARIO.agent_config(i), vehicles=5), ring(5))
    net.run(2 * LEASE)
    assert net.told[4]["leader"] == net.told[4]["candidate"] == 5
    net.kill(5)
    net.run(2 * LEASE + 6)
    assert agreed(net, 1, 1, 2, 3, 4)


def test_records_that_are_old_are_not_passed_on() -> None:
    agent = Election(SCENARIO.agent_config(1), vehicles=5)
    agent.decide(nav(11), [delivery(record(), sent=10)])
    assert [r[0] for r in unpack(RECORDS, agent.transmit(nav(300))[-1])] == [1, 2]
    assert [r[0] for r in unpack(RECORDS, agent.transmit(nav(310))[-1])] == [1]
