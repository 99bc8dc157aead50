"""Link states and traces, compared with theory: shares of time, losses, bursts, and what the draws depend on."""

from __future__ import annotations

from itertools import groupby
from math import exp, sqrt

import numpy as np
import pytest
from any_condition import link_states
from hypothesis import given
from hypothesis import strategies as st

from netem.condition import Condition, FourState, GilbertElliott
from netem.config import NetemConfig
from netem.correlation import lost_share
from netem.faults import NO_FAULTS, NetFault, active_faults
from netem.impairment import LinkModel
from netem.link_states import LinkStates, StateProcess, stationary
from netem.link_trace import DOWN, LinkTrace, TraceProcess
from netem.links import make_links

SECOND = 10**9
PACKETS = 100_000
GOOD, BAD = Condition(50_000_000, loss=0.02), Condition(400_000_000, loss=0.8, rate_bit_s=2000)


def two(good_s: float = 8.0, bad_s: float = 1.5, shared: tuple[int, ...] | None = None) -> LinkStates:
    mean, following = (round(good_s * SECOND), round(bad_s * SECOND)), ((0.0, 1.0), (1.0, 0.0))
    return LinkStates(("good", "bad"), (GOOD, BAD), mean, following, stationary(mean, following), shared)


def links_of(changing: LinkStates | LinkTrace, links: tuple = ((1, 2),), seed: int = 1):
    config = NetemConfig(seed, 10_000_000, 10, (1, 2, 3), links, changing=dict.fromkeys(links, changing))
    return make_links(config)


def test_shares_losses_and_bursts_are_those_of_theory() -> None:
    """100,000 packets, one per second: P(bad), P(lost), and P(lost next | lost) of the hidden chain.

    The chain looked at once a second moves with P(bad to good) = (share of good) (1 - exp(-rate T)), where rate is
    1/8 + 1/1.5 per second. The variance of a mean of correlated packets is larger by (1 + rho) / (1 - rho).
    """
    links = links_of(two())
    outcomes = [links.enter(n * SECOND, (1, 2), n, b"12345678", NO_FAULTS)[0] for n in range(PACKETS)]
    lost = np.array([outcome.cause is not None for outcome in outcomes])
    slow = np.array([outcome.delay_ns for outcome in outcomes if outcome.cause is None]) > 100_000_000
    rho = exp(-(1 / 8 + 1 / 1.5))
    share = 1.5 / 9.5
    loss = share * 0.8 + (1 - share) * 0.02
    error = sqrt(loss * (1 - loss) / PACKETS * (1 + rho) / (1 - rho))
    assert abs(lost.mean() - loss) < 4 * error
    arrived_bad = share * 0.2 / (1 - loss)
    assert abs(slow.mean() - arrived_bad) < 4 * sqrt(arrived_bad / len(slow) * (1 + rho) / (1 - rho))
    stay = np.array(
        [[1 - share * (1 - rho), share * (1 - rho)], [(1 - share) * (1 - rho), 1 - (1 - share) * (1 - rho)]]
    )
    loses = np.array([0.02, 0.8])
    begins = (np.array([1 - share, share]) * (1 - loses)) @ stay * loses
    mean = np.linalg.solve((np.eye(2) - stay * loses).T, begins / begins.sum()).sum()
    bursts = [sum(1 for _ in run) for is_lost, run in groupby(lost.tolist()) if is_lost]
    assert abs(np.mean(bursts) - mean) < 4 * np.std(bursts) / sqrt(len(bursts))


@given(link_states(st.just(Condition())))
def test_shares_balance(states: LinkStates) -> None:
    """In the long run as many transitions lead into each state as out of it: sum_i pi_i q_ij = pi_j / m_j."""
    pi, mean, following = states.shares, states.mean_ns, states.following
    assert sum(pi) == pytest.approx(1.0)
    for j in range(len(pi)):
        assert sum(pi[i] * following[i][j] / mean[i] for i in range(len(pi))) == pytest.approx(pi[j] / mean[j])


@given(link_states(st.just(Condition())), st.lists(st.integers(0, 20 * SECOND), min_size=1, max_size=30))
def test_a_state_depends_on_its_time_alone(states: LinkStates, times: list[int]) -> None:
    """In whatever order, and however often, times are asked for."""
    process = StateProcess(3, states, (1, 2))
    found = [process.state(at) for at in times]
    assert found == [StateProcess(3, states, (1, 2)).state(at) for at in times]


def test_the_chain_is_stationary_from_the_start() -> None:
    """Of 20,000 links as many are bad at once, after half a second, and after a minute, as in the long run."""
    processes = [StateProcess(5, two(), (src, 2)) for src in range(3, 20_003)]
    for at in (0, SECOND // 2, 60 * SECOND):
        bad = sum(process.state(at) for process in processes) / len(processes)
        assert abs(bad - 1.5 / 9.5) < 4 * sqrt(1.5 / 9.5 * 8 / 9.5 / len(processes))


def test_links_share_a_state_or_do_not() -> None:
    times = range(0, 200 * SECOND, SECOND // 2)
    for shared in (None, (0, 0, 0)):
        a, b = (StateProcess(1, two(shared=shared), link) for link in ((1, 2), (2, 1)))
        assert ([a.state(t) for t in times] == [b.state(t) for t in times]) == (shared is not None)


def test_a_packet_has_the_condition_of_its_departure_and_faults_lie_over_it() -> None:
    links, process = links_of(two()), StateProcess(1, two(), (1, 2))
    changes = next(n for n in range(1000) if process.state(n * SECOND) != process.state((n + 1) * SECOND))
    for n in (changes, changes + 1):
        model = LinkModel((GOOD, BAD)[process.state(n * SECOND)], 1, (1, 2))
        assert links.enter(n * SECOND, (1, 2), n, b"1", NO_FAULTS) == model.enter(n * SECOND, n, b"1")
    over = active_faults((NetFault("f", 0, None, "link", ((1, 2),), condition=Condition(SECOND)),), 0)
    assert links.enter(0, (1, 2), 5000, b"1", over)[0].delay_ns == SECOND
    up = active_faults((NetFault("f", 0, None, "up", ((1, 2),)),), 0)
    closed = links_of(LinkTrace((DOWN,)))
    assert closed.enter(0, (1, 2), 0, b"1", NO_FAULTS)[0].cause == "down"
    assert closed.enter(0, (1, 2), 0, b"1", up)[0].cause is None


def test_rows_by_packet_and_by_time() -> None:
    rows = tuple(Condition(delay) for delay in (10, 20, 30))
    by_packet = LinkTrace(rows)
    assert [TraceProcess(1, by_packet, (1, 2)).condition(7, n) for n in range(4)] == [*rows, DOWN]
    assert TraceProcess(1, by_packet, (1, 2)).condition(7, (1 << 40) + 2) == rows[2]  # another try of packet 2
    by_time = LinkTrace(rows, (0, 5, 5), 9, loop=True)  # the second row is in force for no time
    found = [TraceProcess(1, by_time, (1, 2)).condition(at, 0) for at in (0, 4, 5, 8, 9, 14)]
    assert found == [rows[k] for k in (0, 0, 2, 2, 0, 2)]
    assert by_time.shares() == [5 / 9, 0.0, 4 / 9]
    anywhere = LinkTrace(tuple(map(Condition, range(1000))), loop=True, offset=True)
    begins = [TraceProcess(1, anywhere, (1, dst)).condition(0, 0).delay_ns for dst in range(2, 2002)]
    assert abs(np.mean(begins) - 499.5) < 4 * 1000 / sqrt(12 * 2000)


@pytest.mark.parametrize(
    "condition",
    [
        Condition(loss=0.3),
        Condition(loss=0.3, loss_correlation=0.4),
        Condition(loss_model=GilbertElliott(0.1, 0.3, 0.9, 0.05)),
        Condition(loss_model=FourState(0.05, 0.2, 0.3, 0.6, 0.02)),
        Condition(loss_model=FourState(0.05, 0.0, 0.3, 0.6)),
        Condition(loss_model=FourState(0.05, 0.1, 0.3, 0.0)),
        Condition(loss_model=FourState(0.0, 1.0, 0.3, 0.6, 0.2)),
        DOWN,
    ],
)
def test_losses_in_the_long_run(condition: Condition) -> None:
    """Within 1.5 percentage points over 40,000 packets, once the first 1,000 are gone."""
    model = LinkModel(condition, 1, (1, 2))
    lost = [model.enter(n * SECOND, n, b"1")[0].cause is not None for n in range(41_000)]
    assert abs(np.mean(lost[1000:]) - lost_share(condition)) < 0.015
