"""One run of a study, as a worker makes it: plain values in, one row out, whatever happens in between."""

from __future__ import annotations

import time
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from agents.plugins.trust import Trust
from fleet.errors import FleetError
from fleet.execution.judged import judged
from fleet.execution.outcome import Result
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from fleet.study.measures import MEASURES
from fleet.study.modules import NO_MODULES, Modules

A_STUDY = "a study names it"  # why a law that is not installed needs trust
FAILED = "failed"  # the status of a run that has no result


class Task(NamedTuple):
    """A run that is to be made."""

    key: str
    point: int
    seed: int
    name: str  # of the scenario
    text: str  # the whole scenario but for its seed
    timeout_s: float  # of wall time; inf: none
    modules: Modules = NO_MODULES  # that may run besides installed ones


class _TimeoutError(FleetError):
    """A run took too long."""


def make_run(task: Task) -> dict[str, Any]:
    """Make a run; returns its row: `key`, `point`, `seed`, `status`, `reason`, `digest`, verdicts and measures."""
    began = time.monotonic()

    def check(_: float) -> None:
        if time.monotonic() - began > task.timeout_s:
            raise _TimeoutError(f"took longer than {task.timeout_s:g} s")

    row: dict[str, Any] = {"key": task.key, "point": task.point, "seed": task.seed}
    try:
        scenario = _scenario(task)
        result = judged(scenario, check if isfinite(task.timeout_s) else None)
    except Exception as error:  # a law of a user's may raise anything: the study says so and goes on
        reason = str(error) if isinstance(error, FleetError) else f"{type(error).__name__}: {error}"
        return row | {"status": FAILED, "reason": reason[:2000]}
    return row | _measured(result)


def _scenario(task: Task) -> Scenario:
    modules = task.modules
    policy = Policy(Trust(fingerprints=frozenset(modules.fingerprints)), stranger=A_STUDY)
    folder = None if modules.folder is None else Path(modules.folder)
    return parse_scenario(task.text, task.name, [f"seed={task.seed}"], folder, policy)


def _measured(result: Result) -> dict[str, Any]:
    values = result.values
    row: dict[str, Any] = {"status": result.status.name.lower(), "reason": result.reason, "digest": result.digest}
    row["passed"] = result.passed
    for verdict in result.verdicts:  # of several of one check the worst, which are those that failed
        name = verdict.check
        row[f"check.{name}"] = row.get(f"check.{name}", True) and verdict.passed
        if verdict.value is not None:
            row[f"value.{name}"] = max(row.get(f"value.{name}", verdict.value), verdict.value)
    for measure in MEASURES.values():
        row[measure.name] = measure.of(values)
    return row
