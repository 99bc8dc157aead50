"""A study from its plan to its rows: every point is checked before the first run, and no run is made twice."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any

from fleet.execution.external_agents import refuse
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from fleet.study.engine import Engine, Row
from fleet.study.errors import StudyError
from fleet.study.load_points import load_points, point_warnings
from fleet.study.local_engine import engine_of
from fleet.study.measures import STANDING, MeasureColumn
from fleet.study.modules import NO_MODULES, Modules, modules_of
from fleet.study.one_run import A_STUDY, FAILED, Task
from fleet.study.plan import Plan, Point, run_key
from fleet.study.record import VERSION, BorderRecord, StudyRecord, axis_record
from fleet.study.signal_measures import find_columns, is_signal, measures_of_checks, signal_columns_of
from fleet.study.sometimes import column_of, names_of
from fleet.study.spec import KeepLogs, StudySpec
from fleet.study.statistics import Estimate, pass_rate
from fleet.study.stopping import parse_until, watched_by
from fleet.study.store import Store
from fleet.study.study_file import placed
from fleet.study.summary import DEFAULT

_WRITE_S, _WRITE_ROWS = 10.0, 1000  # rows wait at most so long, or until there are so many


@dataclass(slots=True)
class Progress:
    """Where a study is."""

    runs: int  # all of them
    made: int  # that have a row, also from before
    new: int = 0  # made by this program
    judged: int = 0  # of those that are made: with a result
    passed: int = 0  # of these
    failed: int = 0  # of the new ones: without a result
    began: float = 0.0
    doing: str = "runs"  # what is made
    not_kept: list[str] = field(default_factory=list)  # of each log that was to be kept and is not, why

    @property
    def rate(self) -> float:
        """Runs per second of wall time."""
        return self.new / max(1e-9, time.monotonic() - self.began)

    @property
    def passing(self) -> Estimate:
        """The share of all runs so far, of whatever point, that passed."""
        return pass_rate(self.passed, self.judged)

    def count(self, row: Mapping[str, Any]) -> None:
        """Count a row whose run is made."""
        self.judged += row["status"] != FAILED
        self.passed += row["passed"] is True

    @property
    def left_s(self) -> float:
        """Estimated wall time to the end [s]."""
        return (self.runs - self.made) / self.rate if self.new else inf


def prepare(
    plan: Plan,
    directory: Path,
    spec: StudySpec | None = None,
    border: BorderRecord | None = None,
    warn: Callable[[str], None] = lambda _: None,
) -> tuple[Store, Modules]:
    """Check every point, and make the directory of the study.

    Args:
        plan: the runs.
        directory: of the new study.
        spec: the source of the plan; the directory keeps it.
        border: the object of the search, if the study is that of a border.
        warn: called with each check that cannot pass, in words.

    Returns:
        The study, and the modules of laws that its runs need.

    Raises:
        ScenarioError: with the mistakes of all points, each once.
        StudyError: two points are the same, or the directory cannot be made.
    """
    scenarios = load_points(plan)
    for text in point_warnings(plan, scenarios):
        warn(text)
    first, path = scenarios[0], Path(plan.scenario)
    folder = path.parent.resolve() if path.exists() else None
    measures, columns = declared(spec or StudySpec(plan.scenario), scenarios)
    record = StudyRecord(
        margins=True,
        version=VERSION,
        scenario=first.name,
        command=" ".join(change.name for change in plan.changes),
        axes=[axis_record(axis) for axis in plan.axes],
        seeds=list(plan.seeds),
        checks=check_names(scenarios),
        columns=columns,
        made_by=version("uuv-fleet"),
        measures=measures,
        folder=None if folder is None else str(folder),
        spec=None if spec is None else placed(spec),
        border=border,
    )
    rows: list[dict[str, Any]] = [
        {"values": point.values, "scenario": scenario.to_undrawn_yaml()}
        for point, scenario in zip(plan.points, scenarios, strict=True)
    ]
    texts: dict[str, Point] = {}
    for point, row in zip(plan.points, rows, strict=True):
        if (other := texts.setdefault(row["scenario"], point)) is not point:
            what = f"{other.shown} and {point.shown}"
            raise StudyError(f"two points are the same scenario, {what}: does another option overrule what varies?")
    modules = _modules(scenarios, folder)
    return Store.create(directory, record, rows), modules


def declared(spec: StudySpec, scenarios: Sequence[Scenario]) -> tuple[tuple[str, ...], list[MeasureColumn]]:
    """The measures that the table shows, as columns are named, and all columns. Raises StudyError.

    Where no measures are named, those of signals that checks of the scenarios are about stand behind the usual ones.
    """
    measures = tuple(spec.measures)
    if not measures and (checked := measures_of_checks(scenarios)):
        measures = (*DEFAULT, *checked)
    watched = watched_by(spec.until) if spec.until else []
    columns = [*STANDING, *signal_columns_of(filter(is_signal, (*measures, *watched)), scenarios)]
    columns += [MeasureColumn(column_of(name), "") for name in names_of(scenarios)]
    if spec.until:
        parse_until(spec.until, columns)
    return tuple(column.name for column in find_columns(measures, columns)), columns


def modules_again(store: Store) -> Modules:
    """The modules that the runs of a study need that is there. It may come from anybody, so they need trust.

    Raises:
        ScenarioError: one of them may not run, or a scenario is damaged.
        StudyError: the study is damaged.
    """
    policy = Policy(A_STUDY)
    name, folder = store.record.scenario, store.folder
    scenarios = [parse_scenario(row["scenario"], name, folder=folder, policy=policy) for row in store.points()]
    return _modules(scenarios, folder)


def _modules(scenarios: Sequence[Scenario], folder: Path | None) -> Modules:
    for scenario in scenarios:
        refuse(scenario, "a run of a study")
    return modules_of(scenarios, folder)


def check_names(scenarios: Sequence[Scenario]) -> list[str]:
    """The names of the checks that any of the scenarios has, including those that are always judged."""
    always = ["tumbled", "deaths", "qp_infeasible"]
    declared = [
        name
        for scenario in scenarios
        for name in type(scenario.spec.checks).model_fields
        if getattr(scenario.spec.checks, name) is not None and name not in ("signal", "python")
    ]
    declared += [check.name for scenario in scenarios for check in scenario.spec.checks.own() if not check.sometimes]
    expected = ["expect"] if any(scenario.spec.expect != "pass" for scenario in scenarios) else []
    return list(dict.fromkeys([*declared, *always, *expected]))


def run_study(
    store: Store,
    engine: Engine,
    tell: Callable[[Progress], None],
    *,
    modules: Modules = NO_MODULES,
    timeout_s: float = inf,
    budget_s: float = inf,
    logs: KeepLogs | None = None,
) -> Progress:
    """Make every run that has no row yet; then the logs that are kept.

    Args:
        tell: called several times a second.
        modules: that the runs need, and that are let in.
        timeout_s: of wall time, for one run.
        budget_s: of wall time; then no run is made any more, and those under way are given up.
        logs: which are kept; None: as the study says.

    Raises:
        StudyError: rows cannot be written. Earlier rows stay.
        KeyboardInterrupt: at any time; rows that were made are written.
    """
    refuse_border(store)
    kept = store.record.rules.keep_logs if logs is None else logs
    work = Work(store, engine, tell, time.monotonic() + budget_s)
    signals = tuple(column.name for column in store.record.columns if is_signal(column.name))
    with store.locked():
        task = partial(Task, name=store.record.scenario, timeout_s=timeout_s, signals=signals)
        with suppress(_BudgetSpent):
            _make_missing(work, partial(task, modules=engine.carry(modules)))
            _keep_logs(work, partial(task, modules=modules, timeout_s=inf), kept)
    return work.progress


def refuse_border(store: Store) -> None:
    """Raises StudyError: not every point of it is run with every seed."""
    if store.record.border is not None:
        raise StudyError(f"{store.directory} is a study of borders. To continue it: fleet boundary {store.directory}")


class _BudgetSpent(Exception):
    """The wall time that a program may take is over."""


class Work:
    """A study that is being made."""

    def __init__(self, store: Store, engine: Engine, tell: Callable[[Progress], None], until: float) -> None:
        self.store, self.engine, self.until, self._tell = store, engine, until, tell
        self.progress = Progress(0, 0, began=time.monotonic())

    def wait(self) -> None:
        """Show where it is. Raises _BudgetSpent."""
        self._tell(self.progress)
        if time.monotonic() > self.until:
            raise _BudgetSpent


def _make_missing(work: Work, task: Callable[..., Task]) -> None:
    """Round by round, until no point needs more seeds."""
    store, progress = work.store, work.progress
    points, needed, done = store.points(), store.needed(), set[tuple[int, int]]()
    for row in store.table(["point", "seed", "status", "passed"]).to_pylist():
        done.add((row["point"], row["seed"]))
        progress.count(row)
    progress.runs, progress.made = sum(needed.values()), len(done)

    def made(row: Row) -> None:
        done.add((row["point"], row["seed"]))

    while len(done) < progress.runs:
        before = len(done)
        make_runs(work, points, _tasks(store, points, needed, frozenset(done), task), made)
        if len(done) == before:  # or this would go on for ever
            raise StudyError(f"{store.directory} is damaged: runs that were made are missing all the same")
        needed = store.needed(needed)
        progress.runs = sum(needed.values())


def make_runs(
    work: Work, points: list[dict[str, Any]], tasks: Iterator[Task], tell: Callable[[Row], None] = lambda _: None
) -> None:
    """Make some runs of a study that is locked, and write their rows as they come.

    Args:
        work: the study.
        points: all of them.
        tasks: the runs.
        tell: called with each row.
    """
    store, progress = work.store, work.progress
    values = [{axis.key: point[axis.key] for axis in store.record.axes} for point in points]
    rows: list[Row] = []
    written = time.monotonic()

    def write() -> None:
        nonlocal written
        if rows:
            store.add(rows)
            rows.clear()
        written = time.monotonic()

    def take(made: list[Row]) -> None:
        for row in made:
            tell(row)
            rows.append(values[row["point"]] | row)
            progress.count({"passed": None} | row)
            progress.failed += row["status"] == FAILED
        progress.made += len(made)
        progress.new += len(made)
        wait()

    def wait() -> None:
        if len(rows) >= _WRITE_ROWS or time.monotonic() - written > _WRITE_S:
            write()
        work.wait()

    try:
        work.engine.make(tasks, take, wait)
    finally:
        write()


def _tasks(
    store: Store,
    points: list[dict[str, Any]],
    needed: Mapping[int, int],
    done: frozenset[tuple[int, int]],
    task: Callable[..., Task],
) -> Iterator[Task]:
    for n, seed in enumerate(store.seeds):
        for point in points:
            number = point["point"]
            if n < needed[number] and (number, seed) not in done:
                yield task_of(point, seed, task)


def task_of(point: Mapping[str, Any], seed: int, task: Callable[..., Task], log: str = "") -> Task:
    """The run of a point with a seed."""
    text = point["scenario"]
    return task(key=run_key(f"{text}\nseed {seed}"), point=point["point"], seed=seed, text=text, log=log)


def logs_to_make(store: Store, kept: KeepLogs) -> dict[tuple[int, int], str]:
    """The digest of each run whose log is to be kept and not there yet, by point and seed. Raises StudyError."""
    found: dict[tuple[int, int], str] = {}
    if kept == "none":
        return found
    for row in store.table(["point", "seed", "passed", "digest"]).to_pylist():
        wanted = row["digest"] is not None and (kept == "all" or not row["passed"])
        if wanted and not store.log_of(row["point"], row["seed"]).exists():
            found[row["point"], row["seed"]] = row["digest"]
    return found


def _keep_logs(work: Work, task: Callable[..., Task], kept: KeepLogs) -> None:
    """Make the runs again whose logs are kept and not there yet, on this machine, wherever they were made.

    A disk that is full meanwhile costs no row. A run that comes out differently is told, and its log is not kept. To
    write all logs at once and to delete those of runs that passed would cost less only where more than a few runs fail.
    """
    store, progress = work.store, work.progress
    digests, points = logs_to_make(store, kept), store.points()
    if not digests:
        return
    progress.doing, progress.runs, progress.made, progress.new = "logs", len(digests), 0, 0
    progress.began = time.monotonic()

    def take(made: list[Row]) -> None:
        for row in made:
            if row.get("digest") != digests[row["point"], row["seed"]]:
                why = row.get("reason") or "it came out differently: does a law not do the same each time?"
                shutil.rmtree(store.log_of(row["point"], row["seed"]), ignore_errors=True)
                progress.not_kept.append(f"the log of point {row['point']} with seed {row['seed']} is not kept: {why}")
        progress.made += len(made)
        progress.new += len(made)
        work.wait()

    with nullcontext(work.engine) if work.engine.here else engine_of() as engine:
        again = (task_of(points[n], seed, task, str(store.log_of(n, seed))) for n, seed in digests)
        engine.make(again, take, work.wait)
