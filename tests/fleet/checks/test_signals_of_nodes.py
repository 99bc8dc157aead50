"""Checks on signals of nodes: a program that runs and says nothing has failed, and one that is killed has no sample."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

import pytest
import yaml

from fleet.checks.own_checks import OwnChecks
from fleet.checks.values import LoggedValues, Values
from fleet.result.verdict import Verdict
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario

Told = Callable[[int, float], float | None]  # of a node at a time [s]; NaN: nothing yet; None: its program does not run

STACK = {
    "title": "Three programs", "nodes": {"m1": {}, "m2": {}, "m3": {}}, "duration": "2 s",
    "programs": {"m*": {"run": "x"}}, "signals": {"leader": {"line": "(?P<value>.*)"}},
}  # fmt: skip


def stack(check: str) -> Scenario:
    text = yaml.safe_dump(STACK, sort_keys=False)
    return parse_scenario(text, "stack.yaml", [f"checks={{signal: {{name: l, topic: leader, {check}}}}}"])


def judged(check: str, told: Told) -> Verdict:
    scenario = stack(check)
    own = OwnChecks.from_scenario(scenario)
    for tick in range(0, scenario.ticks + 1, 10):
        found: dict[tuple[int, str], Values] = {}
        for i in (1, 2, 3):
            if (value := told(i, tick / 1000)) is not None:
                found[i, "control"] = (value,)
        own.take(LoggedValues(tick, found))
    (verdict,) = [one for one in own.verdicts(over=True) if one.check == "l"]
    return verdict


def silent(i: int, t: float) -> float | None:
    """m2 says nothing until 1 s, the others 1 at all times."""
    return nan if i == 2 and t < 1.0 else 1.0


def killed(i: int, t: float) -> float | None:
    """m2 does not run until 1 s."""
    return None if i == 2 and t < 1.0 else 1.0


def mute(i: int, t: float) -> float | None:
    return nan


ALWAYS = (
    "above: 0", "below: 5", "equals: 1", "within: [0, 2]", "spread_below: 1", "agree_within: 500 ms",
    "never: true, above: 5", "at_most_one: true", "eventually_within: 990 ms, above: 0",
)  # fmt: skip


@pytest.mark.parametrize("check", ALWAYS)
def test_silence_fails_whatever_is_asked_and_a_killed_program_is_not_asked(check: str) -> None:
    """Also where only two others are left, and from when it has spoken on nothing is wrong any more."""

    def less(told: Told) -> Told:
        """At most one is true where all others are not."""
        alone = "at_most_one" in check
        return lambda i, t: 0.0 if alone and told(i, t) == 1.0 else told(i, t)

    verdict = judged(check, less(silent))
    assert (verdict.failed, verdict.moment is not None) == (True, True)
    if "eventually" not in check:
        assert judged(f"{check}, after: 1 s", less(silent)).passed
        assert judged(check, less(killed)).passed
    assert judged(check, mute).failed


def test_a_program_that_is_killed_for_good_need_not_come_to_anything_and_one_that_comes_back_must() -> None:
    """`eventually` waits for every node that is asked; one without a sample has not come there."""
    assert judged("eventually_within: 1 s, above: 0", killed).passed
    assert judged("eventually_within: 990 ms, above: 0", killed).failed
    assert judged("eventually_within: 1500 ms, above: 0", lambda i, t: None if i == 2 else 1.0).failed


def test_a_silence_fails_with_the_node_that_is_silent() -> None:
    verdict = judged("above: 0", silent)
    assert verdict.moment is not None
    assert (verdict.moment.at_s, list(verdict.moment.vehicles)) == (0.0, [2])
    assert "no value yet" in verdict.found


@pytest.mark.parametrize("check", ["above: 0", "spread_below: 5"])
def test_a_failure_by_silence_says_when_it_was_over(check: str) -> None:
    """So it is seen whether the check began too early, or the signal never spoke."""
    assert "no value yet" in (late := judged(check, silent).found) and "; one came by 1 s" in late
    assert "no value yet" in (never := judged(check, mute).found) and "; none came" in never
    assert " came" not in judged("above: 5", lambda i, t: 1.0).found


def test_a_silence_that_may_last_is_none_too_long() -> None:
    assert judged("never: true, above: 5, for_at_least: 1500 ms", silent).passed
    assert judged("never: true, above: 5, for_at_least: 500 ms", silent).failed


@pytest.mark.parametrize(("told", "reached"), [(mute, False), (silent, True), (killed, True)])
def test_silence_reaches_nothing(told: Told, reached: bool) -> None:
    """What some run must reach is reached by a number, and not by none."""
    verdict = judged("above: 0, sometimes: true", told)
    assert (verdict.passed, verdict.reached) == (True, reached)


def test_a_run_in_which_no_program_lived_has_nothing_to_judge() -> None:
    verdict = judged("above: 0", lambda i, t: None)
    assert (verdict.outcome, verdict.found) == (None, "no sample")
