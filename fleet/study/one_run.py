"""One run of a study, as a worker makes it: plain values in, one row out, whatever happens in between."""

from __future__ import annotations

import ctypes
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.metadata import version
from math import isfinite, nan
from pathlib import Path
from secrets import token_hex
from typing import Any, NamedTuple

from fleet.cores import cores
from fleet.errors import FleetError
from fleet.execution.directory import LOG, SCENARIO
from fleet.execution.judged import judged
from fleet.recorder.log_file import LogFile
from fleet.result.file import write_result
from fleet.result.result import Result
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from fleet.study.branches import Branch, run_branch
from fleet.study.errors import StudyError
from fleet.study.measures import MEASURES
from fleet.study.modules import NO_MODULES, Modules, folder_of
from fleet.study.seen import SeenStates
from fleet.study.signal_measures import Samples
from fleet.study.sometimes import column_of
from world.plugins.trust import Trust

A_STUDY = "a study names it"  # why a law that is not installed needs trust
FAILED = "failed"  # the status of a run that has no result
JUDGED = frozenset({"pass", "check_failed"})  # of one that came to its end
GRACE_S = 1.0  # a law may end its tick so long after the time that the run may take


class Task(NamedTuple):
    """A run that is to be made."""

    key: str
    point: int
    seed: int
    name: str  # of the scenario
    text: str  # the whole scenario but for its seed
    timeout_s: float  # of wall time; inf: none
    modules: Modules = NO_MODULES  # that may run besides installed ones
    signals: tuple[str, ...] = ()  # measures of signals, by name
    log: str = ""  # the run directory that is to be made; empty: none
    seen: bool = False  # whether the row has what the run went through
    branch: Branch | None = None  # a part of a run, in place of all of it


def late(task: Task) -> StudyError:
    """The error of a run that takes too long."""
    return StudyError(f"took longer than {task.timeout_s:g} s")


class _AbandonedError(BaseException):
    """Ends the thread of a run that took too long; no law may take it for an error of its own."""


def make_run(task: Task) -> dict[str, Any]:
    """Make a run; returns its row: `key`, `point`, `seed`, `status`, `reason`, `digest`, verdicts and measures.

    A run that takes too long ends between two ticks. Where a law hangs within a tick, it does not end.
    """
    return _whole(task, _made(task))


def make_run_in_time(task: Task) -> dict[str, Any]:
    """The same, for a worker that nobody kills when a law hangs: one of a Dask cluster.

    The run is made in a thread of its own. Where a law hangs within a tick, that thread is ended at its next line of
    Python, and left alone if there is none.
    """
    if not isfinite(task.timeout_s):
        return make_run(task)
    rows: list[dict[str, Any]] = []

    def make() -> None:
        with suppress(_AbandonedError):
            rows.append(_made(task))

    thread = threading.Thread(target=make, daemon=True)
    thread.start()
    thread.join(task.timeout_s + GRACE_S)
    if thread.is_alive():
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(_AbandonedError))
    return _whole(task, rows[0] if rows else _failed(late(task)))


def _whole(task: Task, row: dict[str, Any]) -> dict[str, Any]:
    about = {"key": task.key, "point": task.point, "seed": task.seed, "wall_s": nan}
    return about | row | {"version": version("uuv-fleet"), "cores": cores()}


def _made(task: Task) -> dict[str, Any]:
    began = time.monotonic()

    def check(_: float) -> None:
        if time.monotonic() - began > task.timeout_s:
            raise late(task)

    try:
        scenario = scenario_of(task)
        if task.branch is not None:
            return run_branch(scenario, task.branch, check)
        samples = Samples(scenario, task.signals)
        if task.seen:
            return _seen(scenario, check if isfinite(task.timeout_s) else None, SeenStates(scenario, samples))
        if task.log:
            result = recorded(scenario, Path(task.log), check, samples)
        else:
            result = judged(scenario, check if isfinite(task.timeout_s) else None, samples)
        return _measured(result) | samples.numbers()
    except Exception as error:  # a law of a user's may raise anything: the study says so and goes on
        return _failed(error)


def _seen(scenario: Scenario, check: Callable[[float], None] | None, seen: SeenStates) -> dict[str, Any]:
    """The row of a run, with what it went through, and when each margin was least [s]."""
    result = judged(scenario, check, seen)
    row = _measured(result) | {"seen": seen.features()}
    for verdict in result.checks:
        if (margin := verdict.margin) is not None and row[f"margin.{verdict.check}"] == margin.value:
            row[f"at.{verdict.check}"] = margin.at_s
    return row


def _failed(error: Exception) -> dict[str, Any]:
    """The row of a run without a result, in words."""
    reason = str(error) if isinstance(error, FleetError) else f"{type(error).__name__}: {error}"
    return {"status": FAILED, "reason": reason[:2000]}


def recorded(
    scenario: Scenario,
    directory: Path,
    check: Callable[[float], None] | None = None,
    samples: Samples | None = None,
) -> Result:
    """Make a run, and the directory that `fleet run` would have made; it is there as a whole or not at all."""
    part = directory.with_name(f".{directory.name}-{token_hex(4)}")
    part.mkdir(parents=True)
    try:
        (part / SCENARIO).write_text(scenario.to_yaml(), "utf-8")
        result = judged(scenario, check, samples, LogFile(part / LOG))
        write_result(result, part)
        shutil.rmtree(directory, ignore_errors=True)  # of a study that was killed before it had the row
        os.replace(part, directory)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return result


def scenario_of(task: Task) -> Scenario:
    """The scenario of a run. Raises ScenarioError."""
    modules = task.modules
    policy = Policy(Trust(fingerprints=frozenset(modules.fingerprints)), stranger=A_STUDY)
    return parse_scenario(task.text, task.name, [f"seed={task.seed}"], folder_of(modules), policy)


def failed_checks(row: Mapping[str, Any]) -> list[str]:
    """The names of the checks that fail in a row."""
    return [name.removeprefix("check.") for name, passed in row.items() if name.startswith("check.") and not passed]


def _measured(result: Result) -> dict[str, Any]:
    row: dict[str, Any] = {"status": str(result.status), "reason": result.reason, "digest": result.digest}
    row["passed"] = result.passed
    for verdict in result.checks:  # of several of one check the worst, which are those that failed
        name = verdict.check
        if verdict.reached is not None:
            row[column_of(name)] = float(verdict.reached)
            continue
        row[f"check.{name}"] = row.get(f"check.{name}", True) and verdict.passed
        if verdict.value is not None:
            row[f"value.{name}"] = max(row.get(f"value.{name}", verdict.value), verdict.value)
        if (margin := verdict.margin) is not None:
            row[f"margin.{name}"] = min(row.get(f"margin.{name}", margin.value), margin.value)
    for measure in MEASURES.values():
        row[measure.name] = measure.of(result)
    return row
