"""The scenarios of a study's points, and the mistakes in them.

Two points have the same mistake if only the value that is varied differs: a wrong key is reported once, not per value.
"""

from __future__ import annotations

from dataclasses import replace

from fleet.errors import Problem, ScenarioError
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.overrides import SET
from fleet.study.plan import Plan, Point
from netem.grammar import WORDS
from world.plugins.trust import NOTHING, Trust


def load_points(plan: Plan, trust: Trust = NOTHING, *, refused: list[Problem] | None = None) -> list[Scenario]:
    """The scenario of each point.

    Args:
        refused: a list to which the laws that may not run are appended; None: such a law is an error.

    Raises:
        ScenarioError: with the mistakes of all points, each once.
    """
    scenarios: list[Scenario] = []
    mistakes: dict[tuple[str, int, str], tuple[Problem, list[Point]]] = {}
    for point in plan.points:
        try:
            scenario = load_scenario(plan.scenario, point.changes, trust, refused=refused, origin=plan.origin)
            scenarios.append(scenario)
        except ScenarioError as error:
            for problem in error.problems:
                same = _without_values(problem, point)
                mistakes.setdefault(same, (problem, []))[1].append(point)
    if mistakes:
        raise ScenarioError([_with_points(problem, points, plan) for problem, points in mistakes.values()])
    return scenarios


def _without_values(problem: Problem, point: Point) -> tuple[str, int, str]:
    """What a mistake is apart from the value that is varied: its file or option, column and message."""
    said = f"{problem.file}\n{problem.message}"
    for value in sorted((value.text for value in point.values.values()), key=len, reverse=True):
        said = said.replace(value, "{}")
    return said, problem.line, problem.hint


def _with_points(problem: Problem, points: list[Point], plan: Plan) -> Problem:
    """The mistake, in which points it is if not in all, and how else to vary a condition of links."""
    hint = problem.hint
    key = next((axis.key for axis in plan.axes if problem.file.startswith(f"{SET} {axis.key}=")), "")
    word = key.rpartition(".")[2]
    if word in WORDS and problem.message.startswith("unknown key"):
        hint = (
            f"a condition of links is network.links.*.{word}; or name it in --net '* {word} {{{word}}}' and vary {word}"
        )
    if len(points) == len(plan.points):
        return replace(problem, hint=hint)
    message = f"{problem.message} (in {len(points)} of {len(plan.points)} points, first {points[0].shown})"
    return replace(problem, message=message, hint=hint)
