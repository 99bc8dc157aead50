"""Checks on signals: what breaks them and what does not, what they find, and that their memory does not grow."""

from __future__ import annotations

import gc
import json
import sys
from math import inf, nan

import pytest
from fed_checks import FAULTS, Depth, fed
from small_scenario import small

from fleet.checks.own_checks import OwnChecks
from fleet.checks.values import LoggedValues
from fleet.result.json_text import json_text
from fleet.result.verdict import Verdict


def one(check: str, depth: Depth, *, faults: str = "", until_s: float = 4.0, at_once: bool = True) -> Verdict:
    (verdict,) = fed(f"signal: {{topic: nav.z, {check}}}", depth, faults=faults, until_s=until_s, at_once=at_once)
    return verdict


def peak(i: int, t: float) -> float:
    """Vehicle 2 is 9 m deep from 1.00 s to 1.50 s, all others always 5 m."""
    return 9.0 if i == 2 and 1.0 <= t <= 1.5 else 5.0


@pytest.mark.parametrize(
    ("check", "passed", "value", "words"),
    [
        ("below: 9.5 m", True, 9.0, "at most 9 m (vehicle 2) at 1 s"),
        ("below: 9 m", False, 9.0, "9 m (vehicle 2) at 1 s"),
        ("below: 8 m, vehicles: '1, 3'", True, 5.0, "at most 5 m (vehicle 1) at 0 s"),
        ("below: 8 m, vehicles: all", False, 9.0, "9 m (vehicle 2) at 1 s"),
        ("below: 8 m, after: 2 s", True, 5.0, "at most 5 m (vehicle 1) at 2 s"),
        ("below: 800 cm", False, 9.0, "9 m (vehicle 2) at 1 s"),
        ("above: 5 m", False, 5.0, "5 m, 5 m, 5 m (vehicles 1, 2, 3) at 0 s"),
        ("above: 4 m", True, 5.0, "at least 5 m (vehicle 1) at 0 s"),
        ("never: true, above: 8 m", False, 9.0, "9 m (vehicle 2) at 1 s"),
        ("never: true, above: 9 m", True, 9.0, "at most 9 m (vehicle 2) at 1 s"),
        ("within: [5 m, 9 m]", True, 5.0, "farthest off 5 m (vehicle 1) at 0 s"),
        ("within: [5 m, 8 m]", False, 9.0, "9 m (vehicle 2) at 1 s"),
        ("equals: 5 m, within: 4 m", True, 9.0, "farthest off 9 m (vehicle 2) at 1 s"),
        ("equals: 5 m", False, 9.0, "9 m (vehicle 2) at 1 s"),
        ("never: true, equals: 9 m, after: 2 s", True, 5.0, "nearest to it 5 m (vehicle 1) at 2 s"),
        ("never: true, above: 8 m, for_at_least: 510 ms", True, 0.5, "for at most 0.5 s (vehicle 2), from 1 s"),
        ("never: true, above: 8 m, for_at_least: 500 ms", False, 0.5, "9 m (vehicle 2) at 1.5 s, for 0.5 s by then"),
        ("never: true, above: 20 m, for_at_least: 500 ms", True, 0.0, "at no time"),
        ("spread_below: 4.5 m", True, 4.0, "at most 4 m apart (vehicles 1, 2) at 1 s"),
        ("spread_below: 4 m", False, 4.0, "4 m apart (vehicles 1, 2) at 1 s"),
        ("spread_below: 4 m, vehicles: '1, 3'", True, 0.0, "at most 0 m apart at 0 s"),
        ("agree_within: 500 ms", True, 0.5, "for at most 0.5 s (vehicles 1, 2), from 1 s"),
        ("agree_within: 490 ms", False, 0.5, "4 m apart (vehicles 1, 2) at 1.5 s, for 0.5 s by then"),
        ("at_most_one: true", False, 3.0, "3 true (vehicles 1, 2, 3) at 0 s"),
        ("eventually_within: 2 s, above: 8 m, vehicles: 2", True, 1.0, "after 1 s (vehicle 2)"),
        ("eventually_within: 1 s, above: 8 m, vehicles: 2", True, 1.0, "after 1 s (vehicle 2)"),
        ("eventually_within: 990 ms, above: 8 m, vehicles: 2", False, inf, "not within 0.99 s after 0 s (vehicle 2)"),
        ("eventually_within: 1 s, above: 8 m, after: 2 s", False, inf, "not within 1 s after 2 s (vehicles 1, 2, 3)"),
        ("eventually_within: 2 s, above: 8 m, for_at_least: 500 ms, vehicles: 2", True, 1.0, "after 1 s (vehicle 2)"),
        (
            "eventually_within: 2 s, above: 8 m, for_at_least: 510 ms, vehicles: 2", False, inf,
            "not within 2 s after 0 s (vehicle 2)",
        ),
    ],
)  # fmt: skip
def test_what_is_asked_is_found(check: str, passed: bool, value: float, words: str) -> None:
    for at_once in (True, False):
        verdict = one(check, peak, at_once=at_once)
        assert (verdict.passed, verdict.value) == (passed, value)
        assert verdict.found.removesuffix("; no fault active") == words
        assert (verdict.moment is None) == passed


def test_the_limit_of_agreement_is_the_time_as_given() -> None:
    assert one("agree_within: 490 ms", peak).limit == 0.49


def test_at_most_one_counts_those_that_are_not_zero() -> None:
    leads = {1: (0.0, 2.0), 3: (1.5, 4.0)}  # vehicle -> from, to [s]

    def leader(i: int, t: float) -> float:
        return float(i in leads and leads[i][0] <= t <= leads[i][1])

    verdict = one("at_most_one: true, after: 1 s", leader)
    assert not verdict.passed and verdict.moment is not None
    assert (verdict.moment.tick, verdict.moment.vehicles) == (150, [1, 3])
    assert verdict.moment.values == {"uuv/1/nav.z": 1.0, "uuv/3/nav.z": 1.0}
    leads[3] = (2.01, 4.0)
    assert one("at_most_one: true", leader).passed


def test_what_is_not_reported_is_no_sample_and_breaks_a_stretch() -> None:
    def silent(i: int, t: float) -> float | None:
        return None if i == 2 and t == 1.2 else nan if i == 2 and t == 1.3 else peak(i, t)

    assert one("never: true, above: 8 m, for_at_least: 300 ms", peak).passed is False
    assert one("never: true, above: 8 m, for_at_least: 300 ms", silent).value == pytest.approx(0.19)
    assert one("below: 9.5 m", silent).passed
    assert one("spread_below: 1 m", lambda i, t: 5.0 if i == 1 else None).found == "no sample"
    nothing = one("below: 9.5 m", lambda i, t: None)
    assert (nothing.outcome, nothing.value, nothing.found) == (None, None, "no sample")


def test_infinite_values_break_a_limit_and_stay_out_of_json() -> None:
    verdict = one("below: 9 m", lambda i, t: inf)
    assert not verdict.passed and verdict.moment is not None
    values = json.loads(json_text(verdict))
    assert values["value"] is None and values["moment"]["tick"] == 0
    assert not one("spread_below: 1 m", lambda i, t: inf if i == 1 else 0.0).passed
    assert one("spread_below: 1 m", lambda i, t: inf).passed  # they are the same


def after(*recovered: float) -> Depth:
    """Vehicle 2 is deep from the start and while faults last, and again up so many seconds after each ends."""
    spans = [(0.0, 2.0 + recovered[0]), (2.5, 3.0 + recovered[-1])]
    return lambda i, t: 9.0 if i == 2 and any(begin <= t < end for begin, end in spans) else 5.0


def test_liveness_counts_from_the_end_of_every_fault() -> None:
    every = "below: 8 m, eventually_within: 300 ms, fault: every"
    verdict = one(every, after(0.1, 0.3), faults=FAULTS)
    assert verdict.passed and verdict.value == pytest.approx(0.3)
    assert verdict.found == "after 0.3 s (vehicle 2), the slowest of 2, after fault jam"
    assert verdict.asked == "nav.z below 8 m within 300 ms after every fault"
    late = one(every, after(0.1, 0.35), faults=FAULTS)
    assert not late.passed and late.moment is not None and late.moment.at_s == 3.31
    assert late.found.startswith("not within 0.3 s after the end of fault jam at 3 s (vehicle 2)")
    assert one(every.replace("every", "cut"), after(0.1, 0.35), faults=FAULTS).passed


def test_a_wait_that_another_fault_cuts_short_is_not_judged() -> None:
    long = "below: 8 m, eventually_within: 900 ms, fault: every"
    verdict = one(long, after(0.6, 0.2), faults=FAULTS)  # 0.5 s are between the faults
    assert verdict.passed and verdict.found == "after 0.2 s (vehicle 2); a wait was cut short by another fault"
    only = one(long.replace("every", "cut"), after(0.6, 0.2), faults=FAULTS)
    assert (only.outcome, only.value, only.moment) == (None, None, None)


def test_a_run_that_goes_on_is_told_apart_from_one_that_ended() -> None:
    check = "above: 8 m, eventually_within: 2 s, vehicles: 3"
    now = one(check, peak, until_s=1.0)
    assert (now.outcome, now.value, now.moment, now.found) == (None, None, None, "there is still time")
    over = one(check.replace("2 s", "9 s"), peak)
    assert not over.passed and over.value is None
    assert over.found == "the run ended 4 s after 0 s, too soon to say"
    early = one("below: 8 m, after: 3 s", peak, until_s=2.0)
    assert (early.outcome, early.value, early.found) == (None, None, "no sample yet")


def test_a_check_keeps_nothing_that_grows() -> None:
    scenario = small(
        "duration=1000 s", "checks={signal: [{topic: nav.z, below: 9 m}, {topic: nav.z, agree_within: 1 s}]}"
    )
    own = OwnChecks.from_scenario(scenario)
    assert own is not None

    def feed(ticks: range) -> int:
        for tick in ticks:
            own.take(LoggedValues(tick, {(i, "nav"): (0.0, 0.0, tick % 7 + i / 10, *([0.0] * 7)) for i in (1, 2, 3)}))
        gc.collect()
        return sys.getallocatedblocks()

    before = feed(range(2000))
    assert feed(range(2000, 6000)) - before < 500
