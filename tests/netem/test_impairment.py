"""What a link does to packets, against closed forms and published facts about Linux' netem; three standard errors."""

from __future__ import annotations

import math
from itertools import groupby, pairwise
from typing import Any

import numpy as np
import pytest
from any_condition import conditions
from hypothesis import given
from hypothesis import strategies as st
from samples import samples

from netem.condition import Condition, FourState, GilbertElliott
from netem.config import NetemConfig
from netem.impairment import LinkModel, LinkOutcome
from netem.network import Netem

FloatArray = np.ndarray[Any, np.dtype[np.float64]]
MS = 1_000_000
PAYLOAD = b"state of a vehicle"


def link(condition: Condition, seed: int = 1) -> LinkModel:
    return LinkModel(condition, seed, (1, 2))


def send(model: LinkModel, n: int, every_ns: int = 10**9, payload: bytes = PAYLOAD) -> list[list[LinkOutcome]]:
    """`n` packets, far enough apart that the queue is empty in between."""
    return [model.enter(k * every_ns, k, payload) for k in range(n)]


def losses(condition: Condition, n: int) -> list[bool]:
    return [verdicts[0].cause == "loss" for verdicts in send(link(condition), n)]


def bursts(lost: list[bool]) -> list[int]:
    return [len(list(run)) for is_lost, run in groupby(lost) if is_lost]


# --- loss ------------------------------------------------------------------


def test_gilbert_elliott_against_its_closed_form() -> None:
    """Share of bad time p / (p + r); loss = good (1-k) + bad (1-h); with h = k = 0, 1 bursts last 1 / r packets."""
    n, p, r = samples(60_000), 0.02, 0.25
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
    n = samples(40_000)
    lost = losses(Condition(loss_model=FourState(0.1, 0.9)), n)
    assert abs(sum(lost) / n - 0.1) < 3 * math.sqrt(0.09 / n)
    after = [b for a, b in pairwise(lost) if a]
    assert abs(sum(after) / len(after) - 0.1) < 3 * math.sqrt(0.09 / len(after))


@pytest.mark.parametrize("rho", [0.25, 0.9])
def test_correlation_smooths_the_random_numbers(rho: float) -> None:
    """x_n = (1 - rho) u_n + rho x_(n-1): mean 1/2, variance (1 - rho) / (1 + rho) / 12, lag-1 correlation rho. So, as
    tc-netem(8) warns, the loss it yields is not the one that was asked for."""
    n = samples(40_000)
    model = link(Condition(loss=0.3, loss_correlation=rho))
    numbers, lost = [], []
    for k in range(n):
        lost.append(model.enter(k * 10**9, k, PAYLOAD)[0].cause == "loss")
        numbers.append(model._state.last["loss"])
    x = np.array(numbers)
    effective = n * (1 - rho) / (1 + rho)
    variance = (1 - rho) / (1 + rho) / 12
    assert abs(x.mean() - 0.5) < 3 * math.sqrt(variance / effective)
    assert x.var() == pytest.approx(variance, rel=0.1)
    assert np.corrcoef(x[:-1], x[1:])[0, 1] == pytest.approx(rho, abs=0.03)
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
    n = samples(20_000)
    condition = Condition(1000 * MS, 100 * MS, distribution=distribution)  # type: ignore[arg-type]
    t = (np.array([v[0].delay_ns for v in send(link(condition), n)]) - 1000 * MS) / (100 * MS)
    assert np.quantile(t, QUANTILES) == pytest.approx(expected, abs=0.05)


# Every 256th entry [1/8192], mean, standard deviation and 99th percentile of the tables of iproute2 6.1.0.
TABLES = {
    "normal": (
        [-32768, -12566, -9423, -7267, -5525, -4003, -2610, -1288, 0, 1289, 2611, 4005, 5526, 7268, 9424, 12569],
        (-0.0008, 1.0001, 2.3185),
    ),
    "pareto": (
        [-5461, -5224, -4964, -4679, -4362, -4008, -3609, -3152, -2622, -1996, -1237, -288, 955, 2700, 5461, 11139],
        (-0.0335, 0.8197, 3.9999),
    ),
    "paretonormal": (
        [-12305, -7059, -6078, -5326, -4652, -4006, -3359, -2686, -1966, -1174, -275, 785, 2097, 3842, 6451, 11496],
        (-0.0253, 0.8339, 3.5795),
    ),
}  # fmt: skip


def drawn(n: int, **changes: Any) -> FloatArray:
    """The random part of `n` delays, in units of the jitter."""
    condition = Condition(1000 * MS, 100 * MS, **changes)
    return (np.array([v[0].delay_ns for v in send(link(condition), n)]) - 1000 * MS) / (100 * MS)


@pytest.mark.parametrize("correlation", [0.0, 0.25])
@pytest.mark.parametrize("distribution", TABLES)
def test_delays_fill_the_tables_of_iproute2_evenly(distribution: str, correlation: float) -> None:
    """Sixteen stretches of a table are equally likely; and its tail fits, which those do not see."""
    n = samples(20_000)
    entries, (mean, sd, q99) = TABLES[distribution]
    t = drawn(n, distribution=distribution, delay_correlation=correlation)
    counts = np.histogram(t, [-np.inf, *(entry / 8192 for entry in entries[1:]), np.inf])[0]
    assert ((counts - n / 16) ** 2 / (n / 16)).sum() < 37.7  # chi-square with 15 degrees of freedom: once in 1000
    assert t.mean() == pytest.approx(mean, abs=3 * sd / math.sqrt(n))
    assert t.std() == pytest.approx(sd, rel=0.03)
    assert np.quantile(t, 0.99) == pytest.approx(q99, abs=0.15)
    assert t.max() <= 32767 / 8192 + 1e-6 or distribution == "normal"  # to the nanosecond


@pytest.mark.parametrize("correlation", [0.0, 0.25, 0.9])
def test_a_correlation_leaves_delays_their_distribution(correlation: float) -> None:
    """As in the kernel, whose table is looked up by the low bits of the correlated number: `delay 1000ms 100ms 25%
    distribution normal` keeps its 100 ms, and the delays themselves do not correlate."""
    n = samples(20_000)
    normal = drawn(n, distribution="normal", delay_correlation=correlation)
    uniform = drawn(n, delay_correlation=correlation)
    assert normal.std() == pytest.approx(1.0, rel=0.02)
    assert uniform.std() == pytest.approx(1 / math.sqrt(3), rel=0.02)
    for t in (normal, uniform):
        assert abs(t.mean()) < 3 * t.std() / math.sqrt(n)
        assert abs(np.corrcoef(t[:-1], t[1:])[0, 1]) < 3 / math.sqrt(n)
    assert len(set(drawn(100, delay_correlation=1.0))) == 1


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
    assert causes == [None] * 3 + ["queue"] * 7
    assert [model.enter(10**9, k, bytes(100))[0].cause for k in (10, 11)] == [None, "queue"]


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
    n = samples(20_000)
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
def test_any_change_keeps_what_is_on_its_way(before: Condition, after: Condition, seq: int) -> None:
    """Back to perfect included: what was sent keeps its due tick, and every packet still has one final fate."""
    netem = Netem(NetemConfig(1, 10 * MS, 10, (1, 2), ((1, 2),), {(1, 2): before}))
    fates = list(netem.exchange(0, {1: (PAYLOAD,) * 5, 2: ()}).fates)
    due = sorted(p.due_tick for p in [*netem._transit.announced, *netem._transit.pending[2]])
    netem._links.models[1, 2].condition = after
    assert sorted(p.due_tick for p in [*netem._transit.announced, *netem._transit.pending[2]]) == due
    fates += netem.exchange(10, {1: (PAYLOAD,) * 5, 2: ()}).fates
    netem._links.models[1, 2].condition = Condition()
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
