"""Age of information, connectivity and distance: what is counted as it comes is what a brute force finds afterwards."""

from __future__ import annotations

from math import dist
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple

from fleet.recorder.connectivity import Connectivity
from fleet.recorder.separation import Separation
from netem.ages import Ages, InformationAge
from netem.condition import Condition
from netem.config import NetemConfig
from netem.faults import NetFault
from netem.network import Netem
from netem.wire.messages import Fate, Frame, VehicleFrame

LINKS = ((1, 2), (2, 1), (2, 3), (3, 2))
TICK_NS = 10_000_000


def fate(src: int, dst: int, sent: int, due: int, cause: str = "delivered", corrupted: bool = False) -> Fate:
    return Fate(due, src, dst, 0, 0, sent, due, 0, cause, corrupted, b"")


@st.composite
def histories(draw: st.DrawFn) -> tuple[list[Fate], int]:
    """Fates in the order in which they become final, and the end of the run: late, doubled, lost, damaged."""
    end = draw(st.integers(1, 60))
    some = st.tuples(
        st.sampled_from(LINKS), st.integers(0, end - 1), st.integers(0, 25),
        st.sampled_from(["delivered", "delivered", "loss", "dead receiver"]), st.booleans(),
    )  # fmt: skip
    fates = [fate(*link, sent, min(sent + late, end - 1), cause, bad and cause == "delivered")
             for link, sent, late, cause, bad in draw(st.lists(some, max_size=40))]  # fmt: skip
    return sorted(fates, key=astuple), end


def ages(fates: list[Fate], link: tuple[int, int], end: int) -> list[int]:
    """The definition, tick by tick."""
    whole = [f for f in fates if (f.src, f.dst) == link and f.cause == "delivered" and not f.corrupted]
    return [t - max((f.sent_tick for f in whole if f.due_tick <= t), default=0) for t in range(end)]


def compare(fates: list[Fate], end: int, found: Ages) -> None:
    expected = {link: ages(fates, link, end) for link in LINKS}
    named: dict[str, list[int]] = {f"{a}->{b}": values for (a, b), values in expected.items()}
    named["*"] = [age for values in expected.values() for age in values]
    summary = found.summary(10**9)
    assert set(summary) == set(named)
    for name, values in named.items():
        p95 = sorted(values)[-(-95 * len(values) // 100) - 1]
        assert summary[name] == {"mean_s": pytest.approx(sum(values) / len(values)), "p95_s": p95, "max_s": max(values)}
    for after in range(end + 1):
        worst = max((age for values in expected.values() for age in values[after:]), default=None)
        told = found.oldest(after, LINKS)
        assert (told is None) == (worst is None)
        if told is not None:
            age, link, tick = told
            assert age == worst == expected[link][tick]
            assert tick >= after


@given(histories(), st.lists(st.integers(0, 60)))
def test_ages_are_those_of_the_definition(history: tuple[list[Fate], int], looks: list[int]) -> None:
    """Mean, percentile, maximum, and the maximum from any time on; wherever one looked before the end."""
    fates, end = history
    found = Ages(LINKS)
    for f in fates:
        if f.due_tick in looks:
            found.count(f.due_tick)
        found.settle(f)
    found.count(end)
    compare(fates, end, found)
    found.count(end)
    compare(fates, end, found)


condition = st.builds(
    Condition,
    delay_ns=st.integers(0, 20).map(lambda t: t * TICK_NS),
    jitter_ns=st.integers(0, 20).map(lambda t: t * TICK_NS),
    distribution=st.just("normal"),
    loss=st.floats(0, 1),
    duplicate=st.floats(0, 1),
    corrupt=st.floats(0, 1),
)


@given(st.tuples(condition, condition, condition, condition), st.integers(0, 5), st.booleans(), st.integers(1, 79))
def test_ages_of_what_the_network_does(conditions: Any, cut: int, deaf: bool, end: int) -> None:
    """The order that the network gives its fates is the order that ages and connectivity need."""
    fault = NetFault("f", 10 * cut, 10 * cut + 20, "deaf" if deaf else "mute", vehicles=(2,))
    network = Netem(NetemConfig(1, TICK_NS, 10, (1, 2, 3), LINKS, dict(zip(LINKS, conditions, strict=True)), (fault,)))
    fates = [f for k in range(0, end, 10) for f in network.exchange(k, dict.fromkeys((1, 2, 3), (b"x",))).fates]
    fates += network.close(end)
    found = Ages(LINKS)
    windows = Connectivity(LINKS, (1,), (1, 2, 3), 15)
    for f in fates:
        found.settle(f)
        windows.settle(f)
    found.count(end)
    windows.close(end)
    compare(fates, end, found)
    assert windows.ticks == sum(bool(unreached(fates, t, 15, (1,))) for t in range(14, end))


def test_a_round_of_a_perfect_link() -> None:
    """What is sent at k is usable at k + 1, so that the ages of a round of ten ticks are 1 to 10."""
    age = InformationAge()
    for k in range(0, 1000, 10):
        age.hear(k, k + 1)
    age.count(1001)
    assert age.total - sum(range(1, 11)) * 100 == 0
    assert age.oldest(995) == (10, 1000)
    assert len(age.edges) < 15


def test_what_is_kept_does_not_grow_with_the_run() -> None:
    """A link that works, and one that never does, in a run of ten million ticks."""
    works, silent = InformationAge(), InformationAge()
    for k in range(0, 1_000_000, 10):
        works.hear(k, k + 1 + k // 10 % 7)
    works.count(10_000_000)
    silent.count(10_000_000)
    assert len(works.edges) + len(works.peaks) < 50
    assert (len(silent.edges), silent.oldest()) == (2, (9_999_999, 9_999_999))


# --- connectivity ----------------------------------------------------------


def unreached(fates: list[Fate], t: int, window: int, roots: tuple[int, ...]) -> tuple[int, ...]:
    """The definition, for the window that ends with tick t."""
    links = {
        (f.src, f.dst)
        for f in fates
        if f.cause == "delivered" and not f.corrupted and t - window < f.due_tick <= t
    }  # fmt: skip
    reached = set(roots)
    while new := {b for a, b in links if a in reached} - reached:
        reached |= new
    return tuple(i for i in (1, 2, 3) if i not in reached)


@given(histories(), st.integers(1, 30), st.integers(0, 40), st.sampled_from([(1,), (2,), (1, 3), (1, 2, 3)]))
def test_windows_are_those_of_the_definition(
    history: tuple[list[Fate], int], window: int, after: int, roots: tuple[int, ...]
) -> None:
    fates, end = history
    found = Connectivity(LINKS, roots, (1, 2, 3), window, after)
    for f in fates:
        found.settle(f)
    found.close(end)
    bad = [t for t in range(after + window - 1, end) if unreached(fates, t, window, roots)]
    assert found.windows == max(0, end - (after + window - 1))
    assert found.ticks == len(bad)
    assert found.outages == sum(t - 1 not in bad for t in bad)
    if not bad:
        assert found.first is None
    else:
        assert found.first is not None
        assert found.first.begin == bad[0]
        assert found.first.unreached == unreached(fates, bad[0], window, roots)
        assert found.first.end == next(t for t in range(bad[0], end + 1) if t not in bad)


# --- distance --------------------------------------------------------------

place = st.tuples(*[st.floats(-1e3, 1e3)] * 3)


def frame(tick: int, places: list[Any]) -> Frame:
    rows = tuple(VehicleFrame(i, (*p, 0.0, 0.0), (), (), (), b"", (), (), (), ()) for i, p in enumerate(places, 1))
    return Frame(tick, False, (), (), rows)


@given(st.lists(st.tuples(place, place, place, place), min_size=1, max_size=5), st.integers(0, 3), st.booleans())
def test_separation_is_that_of_the_definition(frames: list[Any], after: int, some: bool) -> None:
    who = [1, 3, 4] if some else [1, 2, 3, 4]
    found = Separation(who, after)
    for tick, places in enumerate(frames):
        found.frame(frame(tick, places))
    pairs = [
        (dist(places[a - 1], places[b - 1]), (a, b), tick)
        for tick, places in enumerate(frames)
        for a in who
        for b in who
        if a < b and tick >= after
    ]
    if not pairs:
        assert found.least is None
    else:
        assert found.least is not None
        assert found.least.distance_m == pytest.approx(min(pairs)[0])
        distances = {(pair, tick): distance for distance, pair, tick in pairs}
        assert distances[found.least.pair, found.least.tick] == pytest.approx(found.least.distance_m)


def test_a_position_that_is_no_number_is_near_everything() -> None:
    found = Separation([1, 2])
    for tick, x in enumerate([5.0, float("nan"), 1.0]):
        found.frame(frame(tick, [(0.0, 0.0, 0.0), (x, 0.0, 0.0)]))
    assert found.least is not None
    assert not found.least.distance_m > 0.5
