"""The verdict on how punctual a run on a wall clock was."""

from __future__ import annotations

import json
import re
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.analysis import punctuality as timing
from fleet.result.timing import Punctual, Spread, Timing
from netem.histogram import Histogram

TIMES = {"count": 100, "negative": 0, "p50_ms": 1.0, "p95_ms": 1.0, "p99_ms": 1.0, "max_ms": 1.0, "histogram_ms": []}
KEPT_UP = {
    "asked": 1000,
    "missed": 0,
    "late": 0,
    "stale": 0,
    "longest": 0,
    "silent": 0,
    "response": TIMES,
    "gap": TIMES,
}
FINE: dict[str, Any] = {
    "world": {"period_ms": 10.0, "slipped_s": 0.0, "held_s": 0.0, "run_s": 10.0, "lag": TIMES, "gap": TIMES},
    "vehicles": {"1": KEPT_UP, "2": KEPT_UP},
    "netem": {
        "late": {"1": 0}, "missed": {"1": 0}, "overdue": 0, "unread": 0, "hop": TIMES, "margin": TIMES, "links": {}
    },
}  # fmt: skip


def measured(values: dict[str, Any]) -> Timing:
    return timing.timing_of(values, 1.0)


def worse(path: str, value: Any) -> Timing:
    changed = json.loads(json.dumps(FINE))
    *most, last = path.split(".")
    place = changed
    for step in most:
        place = place[step]
    place[last] = value
    return measured(changed)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (
            "vehicles.2",
            KEPT_UP | {"missed": 8, "longest": 3},
            r"agent 2 missed 8 of 1000 ticks \(0.80%\), 3 in",
        ),
        ("vehicles.1.silent", 120, r"agent 1 was silent for 1.2 s in all, suspended or stuck$"),
        ("netem.late", {"1": 3}, "3 transmissions"),
        ("netem.missed", {"1": 1}, "1 transmissions"),
        ("netem.overdue", 7, "7 of 100 deliveries"),
        ("world.slipped_s", 0.05, "moved the clock by 0.05 s"),
        ("world.held_s", 2.0, "stood still for 2 s"),
    ],
)
def test_whatever_is_late_degrades_a_run_and_is_named(path: str, value: Any, said: str) -> None:
    assert (measured(FINE).label, measured(FINE).reasons) == ("on time", [])
    bad = worse(path, value)
    assert (bad.label, len(bad.reasons)) == ("degraded", 1)
    assert re.search(said, bad.reasons[0])
    assert timing.timing_of({"netem": {}}, 1.0) is None  # a run that ended before both answered


def test_the_verdict_tolerates_what_was_asked_for() -> None:
    some = worse("vehicles.2", KEPT_UP | {"missed": 8, "longest": 3})
    assert timing.verdict(some, 0.01).passed
    assert not timing.verdict(some, 0.005).passed
    assert timing.verdict(some, 0.01).found.startswith("degraded: agent 2 missed")
    assert not timing.verdict(worse("world.slipped_s", 1.0), 0.01).passed


# --- of the relay


def spread(count: int, late: int) -> Spread:
    """So many times, of which some are a second."""
    found = Histogram()
    for number in range(count):
        found.add(10**9 if number < late else 1000)
    return msgspec.convert(found.to_values(), Spread)


def test_two_late_probes_of_few_fail_nothing() -> None:
    """A run of 25 s in which no message was late."""
    verdict = timing.punctual(Punctual(spread(100, 0), spread(100, 2)), None)
    assert (verdict.passed, verdict.found[:30]) == (True, "1.00% of messages and probes, ")
    assert timing.punctual(Punctual(spread(10, 0), spread(100, 2)), None).passed
    assert not timing.punctual(Punctual(spread(100, 20), spread(100, 0)), None).passed
    assert timing.punctual(Punctual(spread(0, 0), spread(0, 0)), None).passed


def test_a_host_that_delays_the_programs_of_one_node_is_late() -> None:
    """The relay hands everything over in time, and the messages come late to it already."""
    late = Punctual(spread(1000, 0), spread(100, 0), {"auv1": spread(300, 0), "auv2": spread(300, 36)})
    verdict = timing.punctual(late, None)
    assert not verdict.passed and verdict.value == pytest.approx(timing.wilson_low(36, 300))
    assert "programs of auv2 waited longer for a processor in 12.00% of the times in which they ran" in verdict.found
    few = Punctual(spread(1000, 0), spread(100, 0), {"auv1": spread(300, 1), "auv2": spread(0, 0)})
    assert timing.punctual(few, None).passed


@given(st.integers(1, 10**6), st.data())
def test_the_lower_end_is_that_of_wilson(count: int, data: st.DataObject) -> None:
    from scipy.stats import binomtest

    hits = data.draw(st.integers(0, count))
    expected = binomtest(hits, count).proportion_ci(0.95, method="wilson").low
    assert timing.wilson_low(hits, count) == pytest.approx(expected, abs=1e-6)
