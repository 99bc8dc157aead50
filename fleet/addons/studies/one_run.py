"""One run of a study, as a worker makes it: plain values in, one row out, whatever happens in between."""

from __future__ import annotations

import ctypes
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from math import isfinite
from pathlib import Path
from secrets import token_hex
from typing import NamedTuple

from fleet.addons.studies.bare_run import bare_verdicts, fits
from fleet.addons.studies.branches import Branches, run_branches
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import MEASURES
from fleet.addons.studies.modules import NO_MODULES, Modules, folder_of
from fleet.addons.studies.row import FAILED, PREFIX, CheckRow, Row
from fleet.addons.studies.signal_measures import Samples
from fleet.analysis.verdicts import PROGRAMS
from fleet.cores import cores
from fleet.errors import FleetError
from fleet.execution.directory import LOG, SCENARIO
from fleet.execution.stepped_run import Run
from fleet.execution.triggered import resolve_triggers
from fleet.execution.whole_run import run_loaded
from fleet.processes.apart import can_copy, in_child_process
from fleet.recorder.log_file import LogFile, NoDigest
from fleet.result.file import write_result
from fleet.result.result import Result, Status
from fleet.result.verdict import Verdict
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from world.plugins.trust import Trust, trusting

A_STUDY = "a study names it"  # why a law that is not installed needs trust
GRACE_S = 1.0  # a law may end its tick so long after the time that the run may take


class Task(NamedTuple):
    key: str
    point: int
    seed: int
    name: str  # of the scenario
    text: str  # the whole scenario but for its seed
    timeout_s: float  # of wall time; inf: none
    modules: Modules = NO_MODULES  # that may run besides installed ones
    signals: tuple[str, ...] = ()  # measures of signals, by name
    log: str = ""  # the run directory that is to be made; empty: none
    branches: Branches | None = None  # parts of a run, in place of all of it
    healed: tuple[tuple[int, str], ...] = ()  # in its place runs that are healed at a tick, with their scenarios
    keep: str = ""  # of a run of programs: where its directory goes if it fails; empty: nowhere
    bare: bool = False  # without a digest, and without an emulator as far as that is possible


def late(task: Task) -> StudyError:
    return StudyError(f"took longer than {task.timeout_s:g} s")


class _AbandonedError(BaseException):
    """Ends the thread of a run that took too long; no law may take it for an error of its own."""


def make_run(task: Task) -> Row:
    """Make a run; returns its row.

    A run that takes too long ends between two ticks. Where a law hangs within a tick, it does not end.
    """
    return whole_row(task, _make(task))


def make_run_in_time(task: Task) -> Row:
    """The same, for a worker that nobody kills when a law hangs: one of a Dask cluster.

    The run is made in a thread of its own. Where a law hangs within a tick, that thread is ended at its next line of
    Python, and left alone if there is none.
    """
    if not isfinite(task.timeout_s):
        return make_run(task)
    rows: list[Row] = []

    def make() -> None:
        with suppress(_AbandonedError):
            rows.append(_make(task))

    thread = threading.Thread(target=make, daemon=True)
    thread.start()
    thread.join(task.timeout_s + GRACE_S)
    if thread.is_alive():
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(_AbandonedError))
    return whole_row(task, rows[0] if rows else failed_row(task, late(task)))


def whole_row(task: Task, row: Row) -> Row:
    """A row with what names its run, and with what made it."""
    row.key, row.point, row.seed = task.key, task.point, task.seed
    row.version, row.cores = version("uuv-fleet"), cores()
    return row


def _make(task: Task) -> Row:
    began = time.monotonic()

    def check(_: float) -> None:
        if time.monotonic() - began > task.timeout_s:
            raise late(task)

    try:
        scenario = scenario_of(task)
        if task.branches is not None:
            return _futures_row(task, run_branches(scenario, task.branches, check))
        if task.healed:
            return _futures_row(task, healed_runs(task, scenario))
        return _add_program_check(_whole(task, scenario, check), scenario)
    except Exception as error:  # a law of a user's may raise anything: the study says so and goes on
        return failed_row(task, error)


def _whole(task: Task, scenario: Scenario, check: Callable[[float], None]) -> Row:
    in_time = check if isfinite(task.timeout_s) else None
    if task.bare and fits(scenario) and (verdicts := bare_verdicts(scenario, in_time)):
        return _verdict_row(task, verdicts)
    if scenario.spec.triggers:
        scenario = with_triggers_resolved(task)
    samples = Samples(scenario, task.signals)
    if task.log:
        return measured_row(run_and_record(scenario, Path(task.log), check, samples), samples)
    # The digest of a run that fails is that of its repetition: to make it here would make each failure twice.
    result = run_loaded(scenario, in_time, samples, log=NoDigest() if task.bare else None)
    return measured_row(result, samples)


def _add_program_check(row: Row, scenario: Scenario) -> Row:
    """The same with the check of programs: a run shows it when one has failed, and otherwise passes it."""
    if row.judged and scenario.speaking and scenario.spec.checks.programs is None:
        row.checks.setdefault(PROGRAMS, CheckRow(True, 0.0, 0.0))
    return row


def healed_runs(task: Task, scenario: Scenario) -> list[Row]:
    """The rows of runs in which all faults end at a tick, and none begins later; ticks in ascending order.

    Up to its tick each is the same run. So that is made once, if this process can be copied on the way.
    """
    run: Run | None = None
    rows = []
    try:
        for tick, text in task.healed:
            run = Run.prepared(scenario, NoDigest()) if run is None else run
            if tick > run.tick:
                run.go(tick - run.tick)
            make = partial(_make_healed, run, task._replace(text=text))
            if tick < task.healed[-1][0] and run.can_be_copied and can_copy():
                rows.append(in_child_process(make))
            else:
                rows.append(make())
                run = None
    finally:
        if run is not None:
            run.close()
    return rows


def _make_healed(run: Run, task: Task) -> Row:
    before, scenario = run.scenario, scenario_of(task)
    with run:
        run.heal_as(scenario)
        result = run.to_end()
    gone = _own_checks(before) - _own_checks(scenario)  # those about faults that never began
    checks, _ = _check_rows(verdict for verdict in result.checks if verdict.check not in gone)
    return Row(seed=result.seed, status=str(result.status), reason=_text(result.reason), checks=checks)


def _own_checks(scenario: Scenario) -> set[str]:
    return {check.name for check in scenario.spec.checks.own()}


def _futures_row(task: Task, futures: list[Row]) -> Row:
    return Row(seed=task.seed, status=Status.PASS, futures=futures)


def _verdict_row(task: Task, verdicts: Sequence[Verdict]) -> Row:
    checks, numbers = _check_rows(verdicts)
    passed = all(verdict.passed for verdict in verdicts)
    status = Status.PASS if passed else Status.CHECK_FAILED
    return Row(seed=task.seed, status=status, passed=passed, checks=checks, numbers=numbers)


def failed_row(task: Task, error: Exception) -> Row:
    """The row of a run that has no result."""
    reason = str(error) if isinstance(error, FleetError) else f"{type(error).__name__}: {error}"
    return Row(seed=task.seed, status=FAILED, reason=_text(reason[:2000]))


def _text(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()


def run_and_record(
    scenario: Scenario, directory: Path, check: Callable[[float], None] | None = None, samples: Samples | None = None
) -> Result:
    """Make a run, and the directory that `fleet run` would have made; it is there as a whole or not at all."""
    part = directory.with_name(f".{directory.name}-{token_hex(4)}")
    part.mkdir(parents=True)
    try:
        (part / SCENARIO).write_text(scenario.to_yaml(), "utf-8")
        result = run_loaded(scenario, check, samples, LogFile(part / LOG))
        write_result(result, part)
        shutil.rmtree(directory, ignore_errors=True)  # of a study that was killed before it had the row
        os.replace(part, directory)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return result


def scenario_of(task: Task) -> Scenario:
    """The scenario of a run. Raises ScenarioError."""
    return _read(task, lambda scenario: scenario)


def with_triggers_resolved(task: Task) -> Scenario:
    """The same with faults in place of its triggers. Raises ScenarioError."""
    return _read(task, resolve_triggers)


def _read(task: Task, then: Callable[[Scenario], Scenario]) -> Scenario:
    modules = task.modules
    with trusting(Trust(fingerprints=frozenset(modules.fingerprints))):
        read = parse_scenario(task.text, task.name, [f"seed={task.seed}"], folder_of(modules), Policy(A_STUDY))
        found = then(read)
    found.exact_gains = True
    return found


def measured_row(result: Result, samples: Samples) -> Row:
    """The row of a run with a result."""
    checks, numbers = _check_rows(result.checks)
    numbers |= {name: float(measure.of(result)) for name, measure in MEASURES.items()}
    numbers |= {name: float(value) for name, value in samples.numbers().items()}
    return Row(seed=result.seed, status=str(result.status), reason=_text(result.reason),
               digest=result.digest or None,
               passed=result.passed, checks=checks, numbers=numbers)  # fmt: skip


def _check_rows(verdicts: Iterable[Verdict]) -> tuple[dict[str, CheckRow], dict[str, float]]:
    """The rows of some verdicts, and which of those were reached that some run must reach."""
    checks, numbers = dict[str, CheckRow](), dict[str, float]()
    for verdict in verdicts:
        name, margin = verdict.check, verdict.margin
        if verdict.reached is not None:
            numbers[PREFIX + name] = float(verdict.reached)
            continue
        found = CheckRow(
            verdict.outcome,
            None if verdict.value is None else float(verdict.value),
            None if margin is None else float(margin.value),
        )
        checks[name] = checks[name].and_then(found) if name in checks else found
    return checks, numbers
