"""What some run of many must reach: no run fails for it, and that none reached it is said."""

from __future__ import annotations

from math import inf

import pytest
from fed_checks import Depth, fed
from small_scenario import small

from fleet.addons.studies.one_run import Task, make_run
from fleet.addons.studies.row import Reached, Row, sometimes_names
from fleet.addons.studies.search import SearchResult
from fleet.execution.whole_run import run_loaded

PYTHON = "checks={signal: {name: deep, topic: state.z, above: %s, sometimes: true}, "


def peak(i: int, t: float) -> float:
    """Vehicle 2 is 9 m deep from 1.00 s to 1.50 s, all others always 5 m."""
    return 9.0 if i == 2 and 1.0 <= t <= 1.5 else 5.0


@pytest.mark.parametrize(
    ("check", "reached", "words"),
    [
        ("above: 8 m, sometimes: true", True, "reached: 9 m (vehicle 2) at 1 s"),
        ("above: 9 m, sometimes: true", False, "not reached in this run"),
        ("above: 8 m, sometimes: true, for_at_least: 500 ms", True, "for 0.5 s by then"),
        ("above: 8 m, sometimes: true, for_at_least: 510 ms", False, "not reached"),
        ("above: 8 m, sometimes: true, vehicles: 1", False, "not reached"),
        ("above: 8 m, sometimes: true, after: 2 s", False, "not reached"),
    ],
)
def test_a_signal_reaches_it_or_not_and_the_run_passes(check: str, reached: bool, words: str) -> None:
    depth: Depth = peak
    (verdict,) = fed(f"signal: {{topic: nav.z, {check}}}", depth, faults="", until_s=4.0, at_once=True)
    assert (verdict.passed, verdict.reached, verdict.moment) == (True, reached, None)
    assert words in verdict.found and "sometimes" in verdict.asked


def test_what_fails_a_check_in_python_is_what_is_reached() -> None:
    within = "fleet.protocols.checks:AllVisited: {places: [[0, 0, 900]], sometimes: true, name: left-out}}"
    scenario = small(PYTHON % "3 m" + within)
    verdicts = {verdict.check: verdict for verdict in run_loaded(scenario).checks}
    assert verdicts["left-out"].reached and verdicts["left-out"].passed
    assert verdicts["left-out"].found.startswith("reached: 1 of 1 places not visited")
    assert sometimes_names([scenario]) == ["deep", "left-out"]


def test_a_row_has_it_beside_the_checks() -> None:
    text = small("checks={signal: [{name: deep, topic: state.z, above: 99 m, sometimes: true}]}").to_undrawn_yaml()
    row = make_run(Task("k", 0, 3, "small", text, inf))
    assert row.numbers["sometimes.deep"] == 0.0 and "deep" not in row.checks
    never = Reached("deep")
    never.count(row)
    assert never.words == "deep was reached in none of 1 runs"
    never.count(Row(seed=7, status="pass", numbers={"sometimes.deep": 1.0}))
    assert never.words == "deep was reached in 1 of 2 runs, the first seed is 7"


def test_no_bound_where_it_was_never_reached() -> None:
    assert SearchResult("s", 1, runs=200, reached=[Reached("deep", 200, 1, 3)]).most_failures is not None
    assert SearchResult("s", 1, runs=200, reached=[Reached("deep", 200, 0)]).most_failures is None
