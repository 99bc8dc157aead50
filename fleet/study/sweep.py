"""A study from its plan to its rows: every point is checked before the first run, and no run is made twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any

from agents.plugins.trust import NOTHING, Trust
from fleet.errors import Problem, ScenarioError
from fleet.execution.external_agents import refuse
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from fleet.study.engine import Engine, Row
from fleet.study.errors import StudyError
from fleet.study.modules import NO_MODULES, Modules, modules_of
from fleet.study.one_run import A_STUDY, FAILED, Task
from fleet.study.plan import Plan, Point, run_key
from fleet.study.spec import StudySpec
from fleet.study.store import VERSION, Store, StudyRecord, axis_record

_WRITE_S, _WRITE_ROWS = 10.0, 1000  # rows wait at most so long, or until there are so many


@dataclass(slots=True)
class Progress:
    """Where a study is."""

    runs: int  # all of them
    made: int  # that have a row, also from before
    new: int = 0  # made by this program
    passed: int = 0  # of the new ones
    failed: int = 0  # of the new ones: without a result
    began: float = 0.0

    @property
    def rate(self) -> float:
        """Runs per second of wall time."""
        return self.new / max(1e-9, time.monotonic() - self.began)

    @property
    def left_s(self) -> float:
        """Estimated wall time to the end [s]."""
        return (self.runs - self.made) / self.rate if self.new else inf


def load_points(plan: Plan, trust: Trust = NOTHING, *, refused: list[Problem] | None = None) -> list[Scenario]:
    """The scenario of each point.

    Args:
        refused: a list to which the laws that may not run are appended; None: such a law is an error.

    Raises:
        ScenarioError: with the mistakes of all points, each once.
    """
    scenarios: list[Scenario] = []
    mistakes: dict[Problem, list[Point]] = {}
    for point in plan.points:
        try:
            scenario = load_scenario(plan.scenario, point.changes, trust, refused=refused, origin=plan.origin)
            scenarios.append(scenario)
        except ScenarioError as error:
            for problem in error.problems:
                mistakes.setdefault(problem, []).append(point)
    if mistakes:
        raise ScenarioError([_with_points(problem, points, len(plan.points)) for problem, points in mistakes.items()])
    return scenarios


def prepare(
    plan: Plan, directory: Path, trust: Trust = NOTHING, spec: StudySpec | None = None
) -> tuple[Store, Modules]:
    """Check every point, and make the directory of the study.

    Args:
        spec: of which the plan was made; the directory keeps it.

    Returns:
        The study, and the modules of laws that its runs need.

    Raises:
        ScenarioError: with the mistakes of all points, each once.
        StudyError: two points are the same, or the directory cannot be made.
    """
    scenarios = load_points(plan, trust)
    first, path = scenarios[0], Path(plan.scenario)
    folder = path.parent.resolve() if path.exists() else None
    record = StudyRecord(
        version=VERSION,
        scenario=first.name,
        command=" ".join(change.name for change in plan.changes),
        axes=[axis_record(axis) for axis in plan.axes],
        seeds=list(plan.seeds),
        checks=check_names(scenarios),
        made_by=version("uuv-fleet"),
        folder=None if folder is None else str(folder),
        spec=spec,
    )
    rows: list[dict[str, Any]] = [
        {"values": point.values, "scenario": scenario.to_yaml()}
        for point, scenario in zip(plan.points, scenarios, strict=True)
    ]
    texts: dict[str, Point] = {}
    for point, row in zip(plan.points, rows, strict=True):
        if (other := texts.setdefault(row["scenario"], point)) is not point:
            what = f"{other.shown} and {point.shown}"
            raise StudyError(f"two points are the same scenario, {what}: does another option overrule what varies?")
    modules = _modules(scenarios, folder)
    return Store.create(directory, record, rows), modules


def modules_again(store: Store, trust: Trust) -> Modules:
    """The modules that the runs of a study need that is there. It may come from anybody, so they need trust.

    Raises:
        ScenarioError: one of them may not run, or a scenario is damaged.
        StudyError: the study is damaged.
    """
    policy = Policy(trust, A_STUDY)
    name, folder = store.record.scenario, store.folder
    scenarios = [parse_scenario(row["scenario"], name, folder=folder, policy=policy) for row in store.points()]
    return _modules(scenarios, folder)


def _modules(scenarios: Sequence[Scenario], folder: Path | None) -> Modules:
    for scenario in scenarios:
        refuse(scenario, "a run of a study")
    return modules_of(scenarios, folder)


def _with_points(problem: Problem, points: list[Point], of: int) -> Problem:
    """The mistake, and in which points it is, if not in all."""
    if len(points) == of:
        return problem
    return replace(problem, message=f"{problem.message} (in {len(points)} of {of} points, first {points[0].shown})")


def check_names(scenarios: Sequence[Scenario]) -> list[str]:
    """The names of the checks that any of the scenarios has, those that are always judged included."""
    always = ["tumbled", "deaths", "qp_infeasible"]
    declared = [
        name
        for scenario in scenarios
        for name in type(scenario.spec.checks).model_fields
        if getattr(scenario.spec.checks, name) is not None
    ]
    expected = ["expect"] if any(scenario.spec.expect != "pass" for scenario in scenarios) else []
    return list(dict.fromkeys([*declared, *always, *expected]))


def run_study(
    store: Store,
    engine: Engine,
    tell: Callable[[Progress], None],
    *,
    modules: Modules = NO_MODULES,
    timeout_s: float = inf,
) -> Progress:
    """Make every run that has no row yet.

    Args:
        tell: called several times a second.
        modules: that the runs need, and that are let in.
        timeout_s: of wall time, for one run.

    Raises:
        StudyError: rows cannot be written. What was written before stays.
        KeyboardInterrupt: at any time; rows that were made are written.
    """
    task = partial(Task, name=store.record.scenario, timeout_s=timeout_s, modules=modules)
    with store.locked():
        return _run_missing(store, engine, tell, task)


def _run_missing(store: Store, engine: Engine, tell: Callable[[Progress], None], task: Callable[..., Task]) -> Progress:
    done = store.done()
    points, seeds = store.points(), store.record.seeds
    progress = Progress(len(points) * len(seeds), len(done), began=time.monotonic())
    rows: list[Row] = []
    written = time.monotonic()
    values = [{axis.key: point[axis.key] for axis in store.record.axes} for point in points]

    def write() -> None:
        nonlocal written
        if rows:
            store.add(rows)
            rows.clear()
        written = time.monotonic()

    def take(made: list[Row]) -> None:
        for row in made:
            rows.append(values[row["point"]] | row)
            progress.passed += row.get("passed") is True
            progress.failed += row["status"] == FAILED
        progress.made += len(made)
        progress.new += len(made)
        wait()

    def wait() -> None:
        if len(rows) >= _WRITE_ROWS or time.monotonic() - written > _WRITE_S:
            write()
        tell(progress)

    try:
        engine.make(_tasks(store, points, done, task), take, wait)
    finally:
        write()
    return progress


def _tasks(
    store: Store, points: list[dict[str, Any]], done: set[tuple[int, int]], task: Callable[..., Task]
) -> Iterator[Task]:
    for seed in store.record.seeds:
        for point in points:
            number, text = point["point"], point["scenario"]
            if (number, seed) not in done:
                yield task(key=run_key(f"{text}\nseed {seed}"), point=number, seed=seed, text=text)
