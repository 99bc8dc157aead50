"""Average consensus: exact over any network that delivers something, and what the naive version loses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from protocol_network import Link, ProtocolNetwork, delivery, inside, line, nav, ring, stand_still
from samples import samples
from small_scenario import small

from agents.api import pack
from fleet.protocols import average
from fleet.protocols.average import EXACT, NAIVE, ExactAverage, NaiveAverage

pytestmark = pytest.mark.usefixtures("stand_still")
__all__ = ["stand_still"]
MEASURED = {1: 12.0, 2: 19.0, 3: 3.5, 4: -7.0, 5: 11.0}
RING = ring(5)
FIVE = small("vehicles=5", "graph={shape: ring}")


def network(law: Callable[..., Any], links: list[Link] = RING, seed: int = 1) -> ProtocolNetwork:
    scenario = FIVE if links is RING else small("vehicles=5", f"graph={{edges: {{{_edges(links)}}}}}")
    return ProtocolNetwork(lambda i: law(scenario.agent_config(i), value=MEASURED[i]), links, seed)


def _edges(links: list[Link]) -> str:
    return ", ".join(f'"{a}->{b}": 1' for a, b in links)


def off(net: ProtocolNetwork, *those: int) -> float:
    """How far the averages are from the mean of some vehicles at most."""
    mean = sum(MEASURED[i] for i in those) / len(those)
    return max(abs(net.told[i]["average"] - mean) for i in those)


@pytest.mark.parametrize("law", [NaiveAverage, ExactAverage])
def test_without_loss_both_find_the_mean(law: Callable[..., Any]) -> None:
    net = network(law)
    net.run(60)
    assert off(net, *MEASURED) < 1e-9


def test_loss_makes_the_naive_one_agree_on_a_wrong_number() -> None:
    net = network(NaiveAverage)
    net.run(200, loss=0.3)
    averages = net.values("average").values()
    assert max(averages) - min(averages) < 1e-6
    assert off(net, *MEASURED) > 0.1


@settings(max_examples=samples(40))
@given(
    seed=st.integers(0, 10**6),
    loss=st.floats(0.0, 0.6),
    delay=st.tuples(st.integers(1, 20), st.integers(20, 60)),
    links=st.sampled_from([RING, line(2, 4, 1, 5, 3)]),
)
def test_the_exact_one_finds_it_whatever_is_lost_late_or_repeated(
    seed: int, loss: float, delay: tuple[int, int], links: list[Link]
) -> None:
    net = network(ExactAverage, links, seed)
    net.run(100, loss=loss, delay=delay, repeat=0.2)
    net.run(400, delay=delay, repeat=0.2)
    assert off(net, *MEASURED) < 1e-6


@settings(max_examples=samples(40))
@given(seed=st.integers(0, 10**6), victim=st.integers(1, 5), before=st.integers(0, 60), away=st.integers(1, 80))
def test_a_vehicle_that_ends_takes_its_measurement_with_it_and_brings_it_back(
    seed: int, victim: int, before: int, away: int
) -> None:
    """Whenever it ends, and however long it is away: also if the others have not noticed yet."""
    net = network(ExactAverage, seed=seed)
    net.run(before + 1, loss=0.2, delay=(1, 30))
    net.kill(victim)
    net.run(away, loss=0.2, delay=(1, 30))
    if away > 60:  # longer than it takes to be forgotten
        net.run(150)
        assert off(net, *(set(MEASURED) - {victim})) < 1e-6
    net.start(victim)
    net.run(60, loss=0.2, delay=(1, 30))
    net.run(120)
    assert off(net, *MEASURED) < 1e-9


@pytest.mark.parametrize(("loss", "forget_after_s"), [(0.6, 2.3), (0.8, 5.2), (0.9, 11.0)])
def test_at_high_loss_the_estimates_stay_within_what_was_measured(loss: float, forget_after_s: float) -> None:
    """If it is unlikely that so many messages in a row are lost, as the page says."""
    net = ProtocolNetwork(
        lambda i: ExactAverage(FIVE.agent_config(i), value=MEASURED[i], forget_after_s=forget_after_s), RING
    )
    for _ in range(250):
        net.run(1, loss=loss)
        assert all(-7.0 - 1e-9 <= average <= 19.0 + 1e-9 for average in net.values("average").values())
    net.run(300, loss=loss)
    assert off(net, *MEASURED) < 0.01


def test_each_side_of_a_long_partition_has_its_own_mean_and_the_whole_has_one_again() -> None:
    net = network(ExactAverage, line(1, 2, 3, 4, 5))
    net.run(30, loss=0.2)
    net.split([1, 2], [3, 4, 5])
    net.run(150, loss=0.2)
    assert max(off(net, 1, 2), off(net, 3, 4, 5)) < 1e-9
    net.split()
    net.run(300, loss=0.2)
    assert off(net, *MEASURED) < 1e-9


def test_a_link_that_works_one_way_only_is_not_used() -> None:
    net = network(ExactAverage)
    net.cut = {(1, 2)}
    net.run(300)
    assert off(net, *MEASURED) < 1e-9
    assert net.values("links") == {1: 1, 2: 1, 3: 2, 4: 2, 5: 2}


def test_a_vehicle_that_joins_late_counts_from_then_on() -> None:
    net = network(ExactAverage)
    net.run(1)
    net.kill(4)
    net.run(120)
    assert off(net, 1, 2, 3, 5) < 1e-9
    net.start(4)
    net.run(100)
    assert off(net, *MEASURED) < 1e-9


def exact(**changed: Any) -> list[Any]:
    """The values of a message from vehicle 2, which vehicle 1 can take, or with a mistake."""
    row = {"j": 1, "opened": 0, "hears": True, "value": 5.0, "weight": 0.5} | changed
    return [2, [list(row.values())]]


BAD: dict[str, tuple[type[Any], bytes]] = {
    "no list": (ExactAverage, pack(EXACT, 5)),
    "too short": (ExactAverage, pack(EXACT, [2])),
    "no sums": (ExactAverage, pack(EXACT, [2, 7])),
    "a sum too short": (ExactAverage, pack(EXACT, [2, [[1, 0, True]]])),
    "a negative degree": (ExactAverage, pack(EXACT, [-1, []])),
    "opened in the future": (ExactAverage, pack(EXACT, exact(opened=10_000))),
    "a text": (ExactAverage, pack(EXACT, exact(value="5"))),
    "a value out of range": (ExactAverage, pack(EXACT, exact(value=1e300))),
    "a weight out of range": (ExactAverage, pack(EXACT, exact(weight=-1e300))),
    "hears is no bool": (ExactAverage, pack(EXACT, exact(hears=1))),
    "damaged": (ExactAverage, pack(EXACT, exact())[:-1] + b"?"),
    "naive: no list": (NaiveAverage, pack(NAIVE, None)),
    "naive: three numbers": (NaiveAverage, pack(NAIVE, [2, 12.0, 1])),
    "naive: out of range": (NaiveAverage, pack(NAIVE, [2, 1e7])),
    "naive: damaged": (NaiveAverage, pack(NAIVE, [2, 12.0])[:-1] + b"?"),
}


def told_after(law: type[Any], payload: bytes, src: int = 2) -> tuple[Any, Any]:
    """The state, without its count, and what it reports after a payload."""
    agent = law(FIVE.agent_config(1), value=12.0)
    agent.transmit(nav(0))
    _, told = agent.decide(nav(11), [delivery(payload, src, sent=10)])
    state = inside(agent)
    del state["_refused"]
    return state, told


@pytest.mark.parametrize("case", BAD)
def test_what_makes_no_sense_is_refused_and_changes_nothing(case: str) -> None:
    law, payload = BAD[case]
    state, told = told_after(law, payload)
    assert told["refused"] == 1
    assert state == told_after(law, b"")[0]


@pytest.mark.parametrize(("law", "good"), [(ExactAverage, pack(EXACT, exact())), (NaiveAverage, pack(NAIVE, [2, 12]))])
def test_another_protocol_is_passed_over_and_who_is_no_neighbour_refused(law: type[Any], good: bytes) -> None:
    state, told = told_after(law, pack("election", [[1, 2, 3, 4]]))
    assert (told["refused"], state) == (0, told_after(law, b"")[0])
    assert [told_after(law, good, src)[1]["refused"] for src in (2, 3)] == [0, 1]


class Liar(ExactAverage):
    """Says that it has given twice what it gave."""

    def transmit(self, nav: Any) -> list[bytes]:
        honest = super().transmit(nav)
        degree, sums = average.valid_messages(EXACT, [delivery(honest[-1], 1, nav.tick)], lambda *_: True)[0][0][1]
        return [pack(EXACT, [degree, [[j, opened, hears, 2 * y, w] for j, opened, hears, y, w in sums]])]


def test_a_neighbour_that_lies_is_believed_until_it_is_gone() -> None:
    """It shifts what all agree on; when it has been silent for long enough, all of that is taken back."""
    net = ProtocolNetwork(lambda i: (Liar if i == 3 else ExactAverage)(FIVE.agent_config(i), value=MEASURED[i]), RING)
    net.run(40)
    assert off(net, 1, 2, 4, 5) > 1.0
    assert all(math.isfinite(average) for average in net.values("average").values())
    net.kill(3)
    net.run(150)
    assert off(net, 1, 2, 4, 5) < 1e-9


def test_what_is_not_given_is_drawn_from_seed_and_vehicle() -> None:
    def measured(seed: int, i: int) -> float:
        return ExactAverage(small(f"seed={seed}").agent_config(i)).decide(nav(0), [])[1]["measured"]  # type: ignore

    assert measured(1, 1) == measured(1, 1)
    assert len({measured(1, 1), measured(1, 2), measured(2, 1)}) == 3
    drawn = [measured(seed, 1) for seed in range(40)]
    assert 10 <= min(drawn) < 11 and 19 < max(drawn) <= 20
