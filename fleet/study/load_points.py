"""The scenarios of a study's points, and what is to be said against them: mistakes, and checks that cannot pass.

Two points have the same mistake if it differs only in the value that is varied, or in numbers. So a wrong key is
reported once, not per value.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from fleet.analysis.preflight import check_warnings
from fleet.errors import Problem, ScenarioError
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.study.plan import Plan, Point
from netem.grammar import WORDS
from netem.parsing import NUMBER

_NUMBER = re.compile(rf"(?<!\w){NUMBER.pattern}", re.ASCII)


def load_points(plan: Plan, *, refused: list[Problem] | None = None) -> list[Scenario]:
    """The scenario of each point.

    Args:
        refused: a list that receives the laws that may not run; None: such a law is an error.

    Raises:
        ScenarioError: with the mistakes of all points, each once.
    """
    scenarios: list[Scenario] = []
    mistakes: dict[tuple[int, str], tuple[Problem, list[Point]]] = {}
    for point in plan.points:
        try:
            scenario = load_scenario(plan.scenario, point.changes, refused=refused, origin=plan.origin)
            scenarios.append(scenario)
        except ScenarioError as error:
            times: Counter[str] = Counter()  # one point may have several that differ only in numbers
            for problem in error.problems:
                same = _same(problem, point)
                times[same] += 1
                mistakes.setdefault((times[same], same), (problem, []))[1].append(point)
    if mistakes:
        raise ScenarioError([_with_points(problem, points, plan) for problem, points in mistakes.values()])
    return scenarios


def point_warnings(plan: Plan, scenarios: Sequence[Scenario]) -> list[str]:
    """One sentence for each check that cannot pass at some points, as `fleet check` says it."""
    found: dict[str, tuple[str, list[Point]]] = {}
    for point, scenario in zip(plan.points, scenarios, strict=True):
        for text in check_warnings(scenario):
            found.setdefault(_without_values(text, point), (text, []))[1].append(point)
    return [text + _of_points(points, plan) for text, points in found.values()]


def _same(problem: Problem, point: Point) -> str:
    """A text that is the same for the same mistake of another point."""
    words = _without_values(f"{problem.message}\n{problem.hint}", point)
    if problem.file.startswith("--"):  # its value may be the one that is varied, so columns differ
        return f"{_without_values(problem.file, point)}\n{words}"
    return f"{problem.file}:{problem.line}:{problem.column}\n{words}"


def _without_values(text: str, point: Point) -> str:
    """A text without the values of the point, and without other numbers."""
    for value in sorted((value.text for value in point.values.values()), key=len, reverse=True):
        text = re.sub(rf"(?<![\w.]){re.escape(value)}(?!\.?\w)", "{}", text)
    return _NUMBER.sub("{}", text)


def _with_points(problem: Problem, points: list[Point], plan: Plan) -> Problem:
    """The mistake with its points, if not all have it. A wrong word of links gets the two ways to vary it as a hint."""
    hint = problem.hint
    key = next((axis.key for axis in plan.axes if problem.file.startswith(f"{axis.option} {axis.key}=")), "")
    word = key.rpartition(".")[2]
    if word in WORDS and problem.message.startswith("unknown key"):
        hint = (
            f"a condition of links is network.links.*.{word}; or name it in --net '* {word} {{{word}}}' and vary {word}"
        )
    return replace(problem, message=problem.message + _of_points(points, plan), hint=hint)


def _of_points(points: list[Point], plan: Plan) -> str:
    """Which points a sentence is about; empty: all."""
    if len(points) == len(plan.points):
        return ""
    return f" (in {len(points)} of {len(plan.points)} points, first {points[0].shown})"
