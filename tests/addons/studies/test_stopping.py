"""Seeds that are added until an interval is narrow enough."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import STANDING, columns_of_checks
from fleet.addons.studies.row import Row
from fleet.addons.studies.statistics import pass_rate
from fleet.addons.studies.stopping import check_until, parse_until, seed_sequence, seeds_needed


def rows(passed: list[bool]) -> dict[int, Row]:
    """The rows of the seeds 1, 2, ... of a point."""
    return {seed: Row(seed=seed, status="pass", passed=good) for seed, good in enumerate(passed, 1)}


def test_rules_are_read() -> None:
    found = parse_until("pass ±5 %", STANDING)
    assert (found.column, found.margin, found.relative) == (None, 0.05, False)
    found = parse_until("e_rms_m +-0.05 m", STANDING)
    assert (found.columns, found.margin, found.relative) == (["e_rms_m"], 0.05, False)
    found = parse_until("e_rms_m +/- 10%", STANDING)
    assert (found.margin, found.relative) == (0.1, True)
    check_until("p95 error.e_norm ±0.1 m")
    check_until("check.agreement ±5 %")
    check_until("margin.agreement ±0.1 m")


def test_the_share_that_passed_one_check_is_a_rule_like_that_of_all_checks() -> None:
    rule = parse_until("check.live ±10 %", columns_of_checks(["live"]))
    assert (rule.columns, rule.margin, rule.relative) == (["check.live"], 0.1, False)
    some = [Row(seed=seed, status="check_failed", passed=False, numbers={"check.live": seed % 2}) for seed in range(20)]
    unjudged = Row(seed=20, status="check_failed", passed=False)
    assert rule.estimate([*some, unjudged]) == pass_rate(10, 20)
    with pytest.raises(StudyError, match="below 50 %"):
        parse_until("check.live ±60 %", columns_of_checks(["live"]))


def test_a_point_that_is_known_gets_no_more_seeds_and_another_one_does() -> None:
    rule, seeds = parse_until("pass ±10 %", STANDING), seed_sequence(range(1, 21), 1000)
    assert seeds_needed(rule, rows([True] * 20), seeds, 20) == 20  # 84 to 100 %
    assert seeds_needed(rule, rows([True, False] * 10), seeds, 20) == 30  # 30 to 70 %
    assert seeds_needed(rule, rows([True, False] * 46), seeds, 20) == 100  # 20, 30, 45, 67 and 100 are asked for
    assert seeds_needed(rule, {}, seeds, 20) == 20  # none is made yet


def test_seeds_go_on_behind_the_largest_and_end() -> None:
    assert seed_sequence([3, 7, 5], 6) == [3, 7, 5, 8, 9, 10]
    rule = parse_until("pass ±1 %", STANDING)
    assert seeds_needed(rule, rows([True, False] * 50), seed_sequence(range(1, 11), 50), 10) == 50


def test_a_point_without_any_result_gets_no_more_seeds() -> None:
    failed = {seed: Row(seed=seed, status="failed") for seed in range(1, 11)}
    assert seeds_needed(parse_until("pass ±5 %", STANDING), failed, seed_sequence(range(1, 11), 1000), 10) == 10


@given(st.lists(st.booleans(), min_size=10, max_size=200), st.integers(0, 200))
def test_what_is_needed_does_not_depend_on_when_it_is_asked(passed: list[bool], known: int) -> None:
    """A study that was interrupted asks with fewer rows; the seeds that it asks for are never too many."""
    rule, seeds = parse_until("pass ±8 %", STANDING), seed_sequence(range(1, 11), 200)
    every = rows(passed + [True] * (200 - len(passed)))
    needed = seeds_needed(rule, every, seeds, 10)
    some = {seed: row for seed, row in every.items() if seed <= known}
    early = seeds_needed(rule, some, seeds, 10)
    assert early <= needed
    assert seeds_needed(rule, every, seeds, early) == needed
