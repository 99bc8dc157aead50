"""A study from its plan to its rows: every point is checked before the first run, and no run is made twice."""

from __future__ import annotations

import re
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from math import inf
from pathlib import Path

from fleet.addons.studies.engine import engine_of
from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.measures import STANDING, MeasureColumn, columns_of_checks
from fleet.addons.studies.modules import NO_MODULES, Modules, modules_of
from fleet.addons.studies.one_run import A_STUDY, Task
from fleet.addons.studies.plan import Plan, Point, run_key
from fleet.addons.studies.record import VERSION, BorderRecord, StudyRecord, axis_record
from fleet.addons.studies.row import PREFIX, Row, sometimes_names
from fleet.addons.studies.signal_measures import find_columns, is_signal, measures_of_checks, signal_columns_of
from fleet.addons.studies.spec import KeepLogs, StudySpec
from fleet.addons.studies.statistics import Estimate, pass_rate
from fleet.addons.studies.stopping import parse_until, watched_measures
from fleet.addons.studies.store import Store, StudyPoint
from fleet.addons.studies.study_file import with_whole_path
from fleet.addons.studies.summary import DEFAULT, WITHOUT_PLACES
from fleet.analysis.preflight import check_warnings
from fleet.errors import Problem, ScenarioError
from fleet.execution.external_agents import refuse, uses_wall_clock
from fleet.scenario.loading import load_scenario, parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from netem.grammar import WORDS
from netem.parsing import NUMBER, nearest

_WRITE_S, _WRITE_ROWS = 10.0, 1000  # rows wait at most so long, or until there are so many


@dataclass(slots=True)
class Progress:
    runs: int  # all of them
    made: int  # that have a row, also from before
    new: int = 0  # made by this program
    judged: int = 0  # runs with a verdict, also from before
    passed: int = 0  # of the judged ones
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
        return pass_rate(self.passed, self.judged)

    def count(self, passed: bool | None) -> None:
        self.judged += passed is not None
        self.passed += passed is True

    @property
    def left_s(self) -> float:
        """Estimated wall time to the end [s]."""
        return (self.runs - self.made) / self.rate if self.new else inf


def prepare(
    plan: Plan,
    directory: Path | Iterable[Path],
    spec: StudySpec | None = None,
    border: BorderRecord | None = None,
    warn: Callable[[str], None] = lambda _: None,
) -> tuple[Store, Modules]:
    """Check every point, and make the directory of the study. `directory`: of several the first one that is free is
    taken. `spec`: the source of the plan; the directory keeps it.
    `border`: the object of the search, if the study is that of a border. `warn`: called with each check that cannot
    pass, in words. Returns the study, and the modules of laws that its runs need. Raises ScenarioError: with the
    mistakes of all points, each once; StudyError: two points are the same, or the directory cannot be made."""
    scenarios = load_points(plan)
    for text in point_warnings(plan, scenarios):
        warn(text)
    first, path = scenarios[0], Path(plan.scenario)
    folder = path.parent.resolve() if path.exists() else None
    judged_by = "" if border is None else border.check
    measures, columns = measure_columns(spec or StudySpec(plan.scenario, check=judged_by), scenarios)
    record = StudyRecord(
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
        spec=None if spec is None else with_whole_path(spec),
        border=border,
        programs=uses_wall_clock(first),
    )
    texts: dict[str, Point] = {}
    for point, scenario in zip(plan.points, scenarios, strict=True):
        if (other := texts.setdefault(scenario.to_undrawn_yaml(), point)) is not point:
            what = f"{other.shown} and {point.shown}"
            raise StudyError(f"two points are the same scenario, {what}: does another option overrule what varies?")
    modules = _modules(scenarios, folder)
    return Store.create(directory, record, [(point.values, text) for text, point in texts.items()]), modules


def measure_columns(spec: StudySpec, scenarios: Sequence[Scenario]) -> tuple[tuple[str, ...], list[MeasureColumn]]:
    """The measures that the table shows, as columns are named, and all columns of measures. Raises StudyError: there
    is no such check or measure.

    Where no measures are named, those of signals that checks of the scenarios are about stand behind the usual ones.
    """
    measures = tuple(spec.measures)
    usual = WITHOUT_PLACES if scenarios[0].nodes or scenarios[0].spec.moored else DEFAULT
    checked = measures_of_checks(scenarios)
    if not measures and (checked or usual is not DEFAULT):
        measures = (*usual, *checked)
    watched = watched_measures(spec.until) if spec.until else []
    columns = [*STANDING, *signal_columns_of(filter(is_signal, (*measures, *watched)), scenarios)]
    columns += [MeasureColumn(PREFIX + name, "") for name in sometimes_names(scenarios)]
    checks = check_names(scenarios)
    if spec.check and spec.check not in checks:
        hint = nearest(spec.check, checks) or f"there are {', '.join(checks)}"
        raise StudyError(f'there is no check "{spec.check[:60]}"; {hint}')
    every = [*columns, *columns_of_checks(checks)]
    if spec.until:
        parse_until(spec.until, every)
    return tuple(column.name for column in find_columns(measures, every)), columns


def modules_again(store: Store) -> Modules:
    """The modules that the runs of a study need that is there. It may come from anybody, so they need trust. Raises
    ScenarioError: one of them may not run, or a scenario is damaged; StudyError: the study is damaged."""
    policy = Policy(A_STUDY)
    name, folder = store.record.scenario, store.folder
    scenarios = [parse_scenario(point.scenario, name, folder=folder, policy=policy) for point in store.points]
    return _modules(scenarios, folder)


def _modules(scenarios: Sequence[Scenario], folder: Path | None) -> Modules:
    for scenario in scenarios:
        refuse(scenario, "a run of a study", stacks=True)
    return modules_of(scenarios, folder)


def check_names(scenarios: Sequence[Scenario]) -> list[str]:
    """The names of the checks that any of the scenarios has, including those that are always judged."""
    always = ["programs"] if scenarios[0].nodes else ["tumbled", "deaths", "qp_infeasible"]
    always += ["programs"] * any(scenario.speaking for scenario in scenarios)
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
    on_progress: Callable[[Progress], None],
    *,
    modules: Modules = NO_MODULES,
    timeout_s: float = inf,
    budget_s: float = inf,
    logs: KeepLogs | None = None,
) -> Progress:
    """Make every run that has no row yet; then the logs that are kept. `budget_s`: of wall time; then runs that are
    under way are given up. `logs`: None: as the study says. Raises StudyError: rows cannot be written, and earlier ones
    stay; KeyboardInterrupt: at any time, and rows that were made are written."""
    refuse_border(store)
    kept = store.record.rules.keep_logs if logs is None else logs
    work = Work(store, engine, on_progress, time.monotonic() + budget_s)
    signals = tuple(column.name for column in store.record.columns if is_signal(column.name))
    with store.lock():
        like = Task("", 0, 0, store.record.scenario, "", timeout_s, modules, signals, keep=str(store.logs))
        with suppress(_BudgetSpent):
            _make_missing(work, like._replace(modules=engine.carry(modules)))
            _keep_logs(work, like._replace(timeout_s=inf), kept)
    return work.progress


def refuse_border(store: Store) -> None:
    """Raises StudyError: not every point of it is run with every seed."""
    if store.record.border is not None:
        raise StudyError(f"{store.directory} is a study of borders. To continue it: fleet boundary {store.directory}")


class _BudgetSpent(Exception):
    """The wall time that a program may take is over."""


class Work:
    """Makes runs of a study, which is locked, and writes their rows, many at once."""

    def __init__(self, store: Store, engine: Engine, on_progress: Callable[[Progress], None], until: float) -> None:
        self.store, self.engine, self.until, self._on_progress = store, engine, until, on_progress
        self.progress = Progress(0, 0, began=time.monotonic())
        self._waiting, self._written = list[Row](), time.monotonic()

    def wait(self) -> None:
        """Write rows that have waited for long enough, and show where it is. Raises _BudgetSpent."""
        if len(self._waiting) >= _WRITE_ROWS or time.monotonic() - self._written > _WRITE_S:
            self._flush()
        self._on_progress(self.progress)
        if time.monotonic() > self.until:
            raise _BudgetSpent

    def make(self, tasks: Iterator[Task]) -> set[tuple[int, int]]:
        """Make some runs. Returns (point, seed) of those that were made."""
        made, progress = set[tuple[int, int]](), self.progress

        def take(rows: list[Row]) -> None:
            for row in rows:
                made.add((row.point, row.seed))
                progress.count(row.verdict(self.store.record.check))
                progress.failed += not row.has_result
            self._waiting += rows
            progress.made += len(rows)
            progress.new += len(rows)
            self.wait()

        try:
            self.engine.make(tasks, take, self.wait)
        finally:
            self._flush()
        return made

    def _flush(self) -> None:
        if self._waiting:
            self.store.add(self._waiting)
            self._waiting.clear()
        self._written = time.monotonic()


def _make_missing(work: Work, like: Task) -> None:
    store, progress = work.store, work.progress
    needed, done = store.needed_seeds(), set[tuple[int, int]]()
    for row in store.rows():
        done.add((row.point, row.seed))
        progress.count(row.passed)
    progress.runs, progress.made = sum(needed.values()), len(done)
    while len(done) < progress.runs:
        made = work.make(_tasks(store, needed, frozenset(done), like))
        if not made - done:  # or this would go on for ever
            raise StudyError(f"{store.directory} is damaged: runs that were made are missing all the same")
        done |= made
        needed = store.needed_seeds(needed)
        progress.runs = sum(needed.values())


def _tasks(store: Store, needed: Mapping[int, int], done: Set[tuple[int, int]], like: Task) -> Iterator[Task]:
    for n, seed in enumerate(store.seeds):
        for point in store.points:
            if n < needed[point.number] and (point.number, seed) not in done:
                yield task_of(point, seed, like)


def task_of(point: StudyPoint, seed: int, like: Task, log: str = "") -> Task:
    key = run_key(f"{point.scenario}\nseed {seed}")
    return like._replace(key=key, point=point.number, seed=seed, text=point.scenario, log=log)


def logs_to_make(store: Store, kept: KeepLogs) -> dict[tuple[int, int], str]:
    """The digest of each run whose log is to be kept and not there yet, by point and seed. Raises StudyError."""
    if kept == "none":
        return {}
    return {
        (row.point, row.seed): row.digest
        for row in store.rows(details=True)
        if row.digest is not None
        and (kept == "all" or not row.passed)
        and not store.log_of(row.point, row.seed).exists()
    }


def _keep_logs(work: Work, like: Task, kept: KeepLogs) -> None:
    """Make the runs again whose logs are kept and not there yet, on this machine, wherever they were made.

    A disk that is full meanwhile costs no row. A run that comes out differently is told, and its log is not kept. To
    write all logs at once and to delete those of runs that passed would cost less only where more than a few runs fail.
    """
    store, progress = work.store, work.progress
    digests = logs_to_make(store, kept)
    if not digests or like.modules.programs:  # whose runs do not come out the same again: those that fail are kept
        return
    progress.doing, progress.runs, progress.made, progress.new = "logs", len(digests), 0, 0
    progress.began = time.monotonic()

    def take(made: list[Row]) -> None:
        for row in made:
            if row.digest != digests[row.point, row.seed]:
                why = row.reason or "it came out differently: does a law not do the same each time?"
                shutil.rmtree(store.log_of(row.point, row.seed), ignore_errors=True)
                progress.not_kept.append(f"the log of point {row.point} with seed {row.seed} is not kept: {why}")
        progress.made += len(made)
        progress.new += len(made)
        work.wait()

    with nullcontext(work.engine) if work.engine.here else engine_of(NO_MODULES) as engine:
        again = (task_of(store.points[n], seed, like, str(store.log_of(n, seed))) for n, seed in digests)
        engine.make(again, take, work.wait)


_NUMBER = re.compile(rf"(?<!\w){NUMBER.pattern}", re.ASCII)


def load_points(plan: Plan, *, refused: list[Problem] | None = None) -> list[Scenario]:
    """The scenario of each point. `refused`: a list that receives the laws that may not run; None: such a law is an
    error. Raises ScenarioError: with the mistakes of all points, each once."""
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
    return [text + _points_words(points, plan) for text, points in found.values()]


def _same(problem: Problem, point: Point) -> str:
    """A text that is equal where two points have the same mistake: it differs only in the value that is varied, or in
    numbers. So a wrong key is reported once, not per value.
    """
    words = _without_values(f"{problem.message}\n{problem.hint}", point)
    if problem.file.startswith("--"):  # its value may be the one that is varied, so columns differ
        return f"{_without_values(problem.file, point)}\n{words}"
    return f"{problem.file}:{problem.line}:{problem.column}\n{words}"


def _without_values(text: str, point: Point) -> str:
    for value in sorted((value.text for value in point.values.values()), key=len, reverse=True):
        text = re.sub(rf"(?<![\w.]){re.escape(value)}(?!\.?\w)", "{}", text)
    return _NUMBER.sub("{}", text)


def _with_points(problem: Problem, points: list[Point], plan: Plan) -> Problem:
    """The mistake with its points, if not all have it. A wrong word of links, or a
    name that nothing uses, gets the two ways to vary it as a hint."""
    hint = problem.hint
    key = next((axis.key for axis in plan.axes if problem.file.startswith(f"{axis.option} {axis.key}=")), "")
    word = key.rpartition(".")[2]
    if word in WORDS and problem.message.startswith("unknown key"):
        hint = (
            f"a condition of links is network.links.*.{word}; or name it in --net '* {word} {{{word}}}' and vary {word}"
        )
    elif "." not in key and hint.startswith("known here"):  # all keys would hide the way to a name of one's own
        hint = f"a key of a scenario, such as network.period; or use it, as in --net '* loss {{{key}}}'"
    return replace(problem, message=problem.message + _points_words(points, plan), hint=hint)


def _points_words(points: list[Point], plan: Plan) -> str:
    if len(points) == len(plan.points):
        return ""
    return f" (in {len(points)} of {len(plan.points)} points, first {points[0].shown})"
