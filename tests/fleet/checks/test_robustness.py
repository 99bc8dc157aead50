"""Margins: those of signals against their formulas, their signs, and what a check in Python may say of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from fed_checks import fed
from hypothesis import given, settings
from hypothesis import strategies as st

from fleet.result.verdict import Verdict

EVERY = 20  # ticks, of 10 ms, for which a value stays
Steps = list[float]


def always(steps: Steps) -> float:
    return min(6.0 - z for z in steps)


def stretch(steps: Steps) -> float:
    """Stretches of 500 ms or longer, each from some tick on."""
    return min(max(6.0 - z for z in steps[first // EVERY : (first + 50) // EVERY + 1]) for first in range(350))


def eventually(steps: Steps) -> float:
    """Stretches of 500 ms that begin within 2 s."""
    return max(min(6.0 - z for z in steps[first // EVERY : (first + 50) // EVERY + 1]) for first in range(201))


@settings(max_examples=12)
@given(st.lists(st.integers(0, 120).map(lambda n: n / 10), min_size=21, max_size=21))
@pytest.mark.parametrize(
    ("check", "formula"),
    [
        ("below: 6 m", always),
        ("never: true, above: 6 m", always),
        ("never: true, above: 6 m, for_at_least: 500 ms", stretch),
        ("below: 6 m, eventually_within: 2 s, for_at_least: 500 ms", eventually),
    ],
)
def test_margins_are_what_the_formulas_say(check: str, formula: Callable[[Steps], float], steps: Steps) -> None:
    found = one(check, lambda i, t: steps[round(t * 100) // EVERY])
    assert found.margin is not None and found.margin.unit == "m"
    assert found.margin.value == pytest.approx(formula(steps), abs=1e-9)
    assert found.margin.value == 0 or found.passed == (found.margin.value > 0)


@pytest.mark.parametrize(
    ("check", "value", "unit"),
    [
        ("agree_within: 1 s", 0.5, "s"),
        ("agree_within: 200 ms", -0.3, "s"),
        ("equals: 9 m, vehicles: 2, eventually_within: 1500 ms", 0.5, "s"),
        ("at_most_one: true", -2.0, "vehicles"),
        ("spread_below: 5 m", 1.0, "m"),
        ("below: 8 m, eventually_within: 2 s, fault: every", None, ""),  # no fault, so no wait
    ],
)
def test_margins_of_other_conditions(check: str, value: float | None, unit: str) -> None:
    margin = one(check, lambda i, t: 9.0 if i == 2 and 1.0 <= t <= 1.5 else 5.0).margin
    assert (margin is None) == (value is None)
    assert margin is None or (pytest.approx(margin.value), margin.unit) == (value, unit)


def one(check: str, depth: Callable[[int, float], float]) -> Verdict:
    (verdict,) = fed(f"signal: {{topic: nav.z, {check}}}", depth)
    return verdict


@pytest.mark.parametrize(
    ("answer", "value", "found"),
    [
        ("Margin(0.5, 'm', 1.0)", 0.5, "as asked"),
        ("Margin(-0.5, 'm')", 0.0, "as asked"),  # it passed
        ("Margin(float('nan'), 'm')", None, "as asked"),
        ("None", None, "as asked"),
        ("'much'", None, "the check is broken, so nothing is known: Check returned 'much': expected None or a"),
    ],
)
def test_a_check_in_python_says_its_margin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: str, value: float | None, found: str
) -> None:
    name = f"margin_check_{len(answer)}"
    code = "    def __init__(self, facts): pass\n    def step(self, tick): pass\n"
    text = f"from fleet.checks.api import Margin\nclass Check:\n{code}    def margin(self): return {answer}\n"
    (tmp_path / f"{name}.py").write_text(text, "utf-8")
    monkeypatch.chdir(tmp_path)
    (verdict,) = fed(f'"{name}:Check": {{}}', lambda i, t: 5.0)
    assert verdict.found.startswith(found)
    assert (None if verdict.margin is None else verdict.margin.value) == value
