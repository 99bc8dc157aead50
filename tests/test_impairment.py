"""What a link does to packets, against closed forms and published facts about Linux' netem; three standard errors."""

from __future__ import annotations

import math
from itertools import groupby, pairwise

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_grammar import conditions

from netem.config import (
    Condition,
    FourState,
    GilbertElliott,
    NetemConfig,
    condition_from_values,
    condition_values,
)
from netem.impairment import LinkModel, LinkState, Verdict
from netem.network import Netem

MS = 1_000_000
PAYLOAD = b"state of a vehicle"


def link(condition: Condition, seed: int = 1) -> LinkModel:
    return LinkModel(condition, seed, (1, 2))


def send(model: LinkModel, n: int, every_ns: int = 10**9, payload: bytes = PAYLOAD) -> list[list[Verdict]]:
    """`n` packets, far enough apart that the queue is empty in between."""
    return [model.enter(k * every_ns, k, payload) for k in range(n)]


def losses(condition: Condition, n: int) -> list[bool]:
    return [verdicts[0].cause == "loss" for verdicts in send(link(condition), n)]


def bursts(lost: list[bool]) -> list[int]:
    return [len(list(run)) for is_lost, run in groupby(lost) if is_lost]


# --- loss ------------------------------------------------------------------


def test_gilbert_elliott_against_its_closed_form() -> None:
    """Share of bad time p / (p + r); loss = good (1-k) + bad (1-h); with h = k = 0, 1 bursts last 1 / r packets."""
    n, p, r = 60_000, 0.02, 0.25
    simple = losses(Condition(loss_model=GilbertElliott(p, r)), n)
    share = p / (p + r)
    # Neighbouring packets correlate by 1 - p - r, which widens the error by (2 - p - r) / (p + r).
    error = math.sqrt(share * (1 - share) / n * (2 - p - r) / (p + r))
    assert abs(sum(simple) / n - share) < 3 * error
    lengths = bursts(simple)
    assert abs(np.mean(lengths) - 1 / r) < 3 * math.sqrt((1 - r) / r**2 / len(lengths))
    mixed = losses(Condition(loss_model=GilbertElliott(p, r, 0.6, 0.05)), n)
    assert abs(sum(mixed) / n - (share * 0.6 + (1 - share) * 0.05)) < 3 * error


def test_four_state_against_its_chain() -> None:
    """The stationary loss of the published transition matrix (states 3 and 4), and the length of loss bursts."""
    model = FourState(p13=0.02, p31=0.3, p32=0.2, p23=0.4, p14=0.03)
    n = 80_000
    chain = np.array(
        [
            [1 - model.p13 - model.p14, 0, model.p13, model.p14],
            [0, 1 - model.p23, model.p23, 0],
            [model.p31, model.p32, 1 - model.p31 - model.p32, 0],
            [1, 0, 0, 0],
        ]
    )
    values, vectors = np.linalg.eig(chain.T)
    stationary = np.real(vectors[:, np.argmin(abs(values - 1))])
    stationary /= stationary.sum()
    lost = losses(Condition(loss_model=model), n)
    expected = stationary[2] + stationary[3]
    assert abs(sum(lost) / n - expected) < 3 * math.sqrt(expected * (1 - expected) / n * 5)
    # A burst begins from 1 (to 3 or 4) or from 2 (to 3): alone it is one packet, in state 3 it lasts 1 / (p31 + p32).
    into_3 = stationary[0] * model.p13 + stationary[1] * model.p23
    into_4 = stationary[0] * model.p14
    mean = (into_3 / (model.p31 + model.p32) + into_4) / (into_3 + into_4)
    lengths = bursts(lost)
    assert abs(np.mean(lengths) - mean) < 3 * np.std(lengths) / math.sqrt(len(lengths))


def test_defaults_make_the_four_state_model_bernoulli() -> None:
    """`loss state P`: p31 = 1 - p13, so every packet is lost with P whatever happened before."""
    n = 40_000
    lost = losses(Condition(loss_model=FourState(0.1, 0.9)), n)
    assert abs(sum(lost) / n - 0.1) < 3 * math.sqrt(0.09 / n)
    after = [b for a, b in pairwise(lost) if a]
    assert abs(sum(after) / len(after) - 0.1) < 3 * math.sqrt(0.09 / len(after))


@pytest.mark.parametrize("rho", [0.25, 0.9])
def test_correlation_smooths_the_random_numbers(rho: float) -> None:
    """x_n = (1 - rho) u_n + rho x_(n-1): mean 1/2, variance (1 - rho) / (1 + rho) / 12, lag-1 correlation rho. So, as
    tc-netem(8) warns, the loss it yields is not the one that was asked for."""
    n = 40_000
    jitter = Condition(100 * MS, 100 * MS, delay_correlation=rho)
    x = np.array([verdicts[0].delay_ns for verdicts in send(link(jitter), n)]) / (200 * MS)
    effective = n * (1 - rho) / (1 + rho)
    variance = (1 - rho) / (1 + rho) / 12
    assert abs(x.mean() - 0.5) < 3 * math.sqrt(variance / effective)
    assert x.var() == pytest.approx(variance, rel=0.1)
    assert np.corrcoef(x[:-1], x[1:])[0, 1] == pytest.approx(rho, abs=0.03)
    lost = losses(Condition(loss=0.3, loss_correlation=rho), n)
    assert sum(lost) / n < 0.27
    assert np.mean(bursts(lost)) > np.mean(bursts(losses(Condition(loss=0.3), n)))


# --- delay -----------------------------------------------------------------

QUANTILES = [0.1, 0.25, 0.5, 0.75, 0.9]


@pytest.mark.parametrize(
    ("distribution", "expected"),
    [
        ("uniform", [-0.8, -0.5, 0.0, 0.5, 0.8]),
        ("normal", [-1.2816, -0.6745, 0.0, 0.6745, 1.2816]),
        # ((1 - q)^(-1/3) - 1.5) 4/3, of iproute2's table
        ("pareto", [(1 - q) ** (-1 / 3) * 4 / 3 - 2 for q in QUANTILES]),
    ],
)
def test_delay_distributions_have_their_quantiles(distribution: str, expected: list[float]) -> None:
    n = 20_000
    condition = Condition(1000 * MS, 100 * MS, distribution=distribution)  # type: ignore[arg-type]
    t = (np.array([v[0].delay_ns for v in send(link(condition), n)]) - 1000 * MS) / (100 * MS)
    assert np.quantile(t, QUANTILES) == pytest.approx(expected, abs=0.05)


def test_paretonormal_is_a_quarter_normal_and_three_quarters_pareto() -> None:
    """The variance of a sum of independent parts: (1 + 9 var(Pareto)) / 16; and the tail of Pareto."""
    n = 20_000

    def t(distribution: str) -> np.ndarray:
        condition = Condition(1000 * MS, 100 * MS, distribution=distribution)  # type: ignore[arg-type]
        return (np.array([v[0].delay_ns for v in send(link(condition), n)]) - 1000 * MS) / (100 * MS)

    mixed, pareto = t("paretonormal"), t("pareto")
    assert mixed.var() == pytest.approx((1 + 9 * pareto.var()) / 16, rel=0.05)
    assert pareto.max() <= 32767 / 8192 + 1e-6  # to the nanosecond
    assert ((mixed - mixed.mean()) ** 3).mean() > 0


def test_no_delay_is_negative() -> None:
    condition = Condition(10 * MS, 100 * MS, distribution="normal")
    delays = [verdicts[0].delay_ns for verdicts in send(link(condition), 2000)]
    assert min(delays) == 0
    assert delays.count(0) > 700


# --- order -----------------------------------------------------------------


def test_jitter_alone_reorders_and_constant_delay_does_not() -> None:
    """tc-netem(8): with enough variation a later packet overtakes; without jitter the link is a queue."""
    for jitter, overtakes in ((50 * MS, True), (0, False)):
        model = link(Condition(100 * MS, jitter))
        leaves = [k * 10 * MS + model.enter(k * 10 * MS, k, PAYLOAD)[0].delay_ns for k in range(200)]
        assert (leaves != sorted(leaves)) == overtakes


def test_reorder_sends_some_at_once() -> None:
    """`delay 10ms reorder 25%`: a quarter leave at once, the others after 10 ms; with a gap only every fifth may."""
    n = 8000
    delays = [v[0].delay_ns for v in send(link(Condition(10 * MS, reorder=0.25, gap=1)), n)]
    assert set(delays) == {0, 10 * MS}
    assert abs(delays.count(0) / n - 0.25) < 3 * math.sqrt(0.25 * 0.75 / n)
    every = [v[0].delay_ns for v in send(link(Condition(10 * MS, reorder=1.0, gap=5)), 20)]
    assert every == [10 * MS] * 4 + [0] + ([10 * MS] * 4 + [0]) * 3
    apart = [v[0].delay_ns for v in send(link(Condition(10 * MS, reorder=0.5, gap=5)), n)]
    assert min(len(list(run)) for delayed, run in groupby(apart) if delayed) >= 4


# --- rate and limit --------------------------------------------------------


def test_a_rate_sends_one_packet_after_the_other() -> None:
    """100 bytes at 8 kbit/s take 100 ms each, also when they come at once; delay runs beside waiting, not after it."""
    model = link(Condition(rate_bit_s=8000))
    assert [model.enter(0, k, bytes(100))[0].delay_ns for k in range(3)] == [100 * MS, 200 * MS, 300 * MS]
    assert model.enter(250 * MS, 3, bytes(100))[0].delay_ns == 150 * MS
    assert model.enter(10**9, 4, bytes(50))[0].delay_ns == 50 * MS
    overhead = link(Condition(rate_bit_s=8000, rate_overhead=25))
    assert overhead.enter(0, 0, bytes(100))[0].delay_ns == 125 * MS
    both = link(Condition(250 * MS, rate_bit_s=8000))
    assert [both.enter(0, k, bytes(100))[0].delay_ns for k in range(2)] == [350 * MS, 450 * MS]


def test_a_full_queue_drops() -> None:
    """`limit 3` at one packet per second: ten at once leave three, and there is room again when one has left."""
    model = link(Condition(rate_bit_s=800, limit=3))
    causes = [model.enter(0, k, bytes(100))[0].cause for k in range(10)]
    assert causes == [""] * 3 + ["queue"] * 7
    assert [model.enter(10**9, k, bytes(100))[0].cause for k in (10, 11)] == ["", "queue"]


@given(st.integers(100, 10**6), st.lists(st.tuples(st.integers(0, 10**9), st.integers(1, 500)), max_size=30))
def test_a_rate_is_never_exceeded(rate: int, traffic: list[tuple[int, int]]) -> None:
    """In the order of leaving, each packet leaves at least its own transmission time after the one before."""
    model = link(Condition(rate_bit_s=rate))
    now, leaves = 0, []
    for seq, (pause, size) in enumerate(traffic):
        now += pause
        leaves.append((now + model.enter(now, seq, bytes(size))[0].delay_ns, size))
    assert leaves == sorted(leaves)
    for (before, _), (after, size) in pairwise(leaves):
        assert after - before >= size * 8 * 10**9 // rate


# --- duplicate and corrupt -------------------------------------------------


def test_duplicates_and_their_own_fate() -> None:
    """Both copies draw their own delay; a packet that is duplicated and lost goes on as one (sch_netem)."""
    n = 20_000
    verdicts = send(link(Condition(100 * MS, 50 * MS, 0.2, duplicate=0.3)), n)
    twice = [v for v in verdicts if len(v) == 2]
    assert abs(len(twice) / n - 0.3 * 0.8) < 3 * math.sqrt(0.24 * 0.76 / n)
    lost = sum(v[0].cause == "loss" for v in verdicts)
    assert abs(lost / n - 0.7 * 0.2) < 3 * math.sqrt(0.14 * 0.86 / n)
    clones = [v[1].cause == "loss" for v in twice]
    assert abs(sum(clones) / len(clones) - 0.2) < 3 * math.sqrt(0.16 / len(clones))
    assert any(a.delay_ns != b.delay_ns for a, b in twice)


@given(st.binary(max_size=40), st.integers(0, 1000))
def test_corruption_flips_one_bit(payload: bytes, seq: int) -> None:
    (verdict,) = link(Condition(corrupt=1.0)).enter(0, seq, payload)
    flipped = sum((a ^ b).bit_count() for a, b in zip(payload, verdict.payload, strict=True))
    assert (flipped, verdict.corrupted) == ((1, True) if payload else (0, False))


def test_corruption_reaches_every_bit() -> None:
    seen = {v[0].payload for v in send(link(Condition(corrupt=1.0)), 2000, payload=b"\x00\x00")}
    assert len(seen) == 16


# --- live changes, memory --------------------------------------------------


@given(conditions(), conditions(), st.integers(0, 20))
@settings(max_examples=80, deadline=None)
def test_any_change_keeps_what_is_on_its_way(before: Condition, after: Condition, seq: int) -> None:
    """Back to perfect included: what was sent keeps its due tick, and every packet still has one final fate."""
    netem = Netem(NetemConfig(1, 10 * MS, 10, (1, 2), ((1, 2),), {(1, 2): before}))
    fates = list(netem.exchange(0, {1: (PAYLOAD,) * 5, 2: ()}).fates)
    due = sorted(p.due_tick for p in [*netem._announced, *netem._pending[2]])
    netem.set_condition((1, 2), after)
    assert sorted(p.due_tick for p in [*netem._announced, *netem._pending[2]]) == due
    fates += netem.exchange(10, {1: (PAYLOAD,) * 5, 2: ()}).fates
    netem.set_condition((1, 2), Condition())
    fates += netem.exchange(20, {1: (PAYLOAD,), 2: ()}).fates
    fates += netem.close(30)
    assert len({(f.seq, f.copy) for f in fates}) == len(fates)
    assert {f.seq for f in fates} == set(range(11))
    last = next(f for f in fates if f.seq == 10)
    assert last.due_tick == 21


def test_a_value_that_changes_and_comes_back_shifts_no_draw() -> None:
    """Draws are keyed by the packet's number: what another value did meanwhile leaves no trace."""
    condition = Condition(200 * MS, 100 * MS, 0.3)
    steady, changed = link(condition), link(condition)
    for k in range(100):
        changed.condition = Condition(50 * MS, 50 * MS, 0.9, duplicate=0.5) if 30 <= k < 60 else condition
        a, b = steady.enter(k * 10**9, k, PAYLOAD), changed.enter(k * 10**9, k, PAYLOAD)
        if not 30 <= k < 60:
            assert a == b


@given(conditions(), st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_a_link_goes_on_from_its_plain_values(condition: Condition, seed: int) -> None:
    one = link(condition, seed)
    for k in range(20):
        one.enter(k * MS, k, PAYLOAD)
    values = msgpack.unpackb(msgpack.packb([condition_values(one.condition), one.state.to_values()]))
    other = LinkModel(condition_from_values(values[0]), seed, (1, 2), LinkState.from_values(values[1]))
    assert other.condition == condition
    assert [other.enter(k * MS, k, PAYLOAD) for k in range(20, 40)] == [
        one.enter(k * MS, k, PAYLOAD) for k in range(20, 40)
    ]


def test_a_link_with_its_own_seed() -> None:
    """`seed` moves one link to other draws, whatever the scenario's seed is."""
    lossy = Condition(loss=0.5)
    own = Condition(loss=0.5, seed=7)
    assert losses(lossy, 200) != [v[0].cause == "loss" for v in send(link(own, 1), 200)]
    assert [v[0].cause for v in send(link(own, 1), 200)] == [v[0].cause for v in send(link(own, 2), 200)]


def test_a_condition_put_over_a_link_does_not_seed_it_anew() -> None:
    model = link(Condition(seed=7))
    over = [bool(model.enter(k * 10**8, k, b"x", Condition(loss=0.5))[0].cause) for k in range(50)]
    own = link(Condition(loss=0.5, seed=7))
    assert over == [bool(own.enter(k * 10**8, k, b"x")[0].cause) for k in range(50)]
