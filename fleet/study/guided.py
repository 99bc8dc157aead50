"""A guided search: it changes fault lists that brought a check near to failing, or a run to something new.

Runs come in generations of a fixed size. Each generation follows from the results of all earlier ones, by keyed draws.
So the result does not depend on the number of workers. A quarter of a generation are seeds, as in a plain search. The
rest are moves (`moves`) on fault lists of a corpus. For each check, the corpus has the lists with the smallest margins,
and the lists that went through something new (`seen`).
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, isfinite

from fleet.errors import ScenarioError
from fleet.execution.external_agents import refuse
from fleet.scenario.scenario import Scenario
from fleet.study.confirmed import compared, repeat_of
from fleet.study.engine import Engine, Row
from fleet.study.errors import StudyError
from fleet.study.failures import FailureFolder, FoundFailure, file_of
from fleet.study.guided_memory import ROW_KEYS, GuidedMemory, GuidedMemoryFile, KnownRun
from fleet.study.modules import NO_MODULES, Modules
from fleet.study.moves import Draws, Fault, Mutator, end_of
from fleet.study.one_run import JUDGED, Task, failed_checks, scenario_of
from fleet.study.plan import run_key
from fleet.study.search import Searched, failures_of
from fleet.study.shrink import Tree, tree_of
from fleet.study.sometimes import Reached, names_of
from fleet.study.spec import LARGEST_SEED

GENERATION = 8  # runs
_FRESH = 0.25  # of a generation: seeds as they come
_NOVEL = 0.3  # of the others: from lists that went through something new
_KEPT = 10  # lists of a check, and of those that are new
_TRIES = 8  # to make a list that is a valid scenario


@dataclass(slots=True)
class Corpus:
    """The fault lists that are worth changing."""

    check: str | None  # which must fail; None: any
    nearest: dict[str, list[KnownRun]] = field(default_factory=dict)  # by check, the smallest margin first
    novel: deque[KnownRun] = field(default_factory=lambda: deque(maxlen=_KEPT))
    seen: set[int] = field(default_factory=set)
    spread: dict[str, set[float]] = field(default_factory=dict)  # margins of a check: one alone tells nothing
    failed: set[str] = field(default_factory=set)  # checks of which a failure is kept, which guide nobody any more

    def take(self, tried: KnownRun, features: list[int]) -> None:
        """Keep a run if it is near to failing, or new."""
        if not self.seen.issuperset(features):
            self.seen.update(features)
            self.novel.append(tried)
        for check, (margin, _) in tried.margins.items():
            if self.check not in (None, check) or check in self.failed:
                continue
            self.spread.setdefault(check, set()).add(margin)
            near = self.nearest.setdefault(check, [])
            near.append(tried)
            near.sort(key=lambda one: one.margins[check][0])  # stable: of equal ones the first
            del near[_KEPT:]

    def leave(self, check: str) -> None:
        """A failure of this check is kept: look for others."""
        self.failed.add(check)
        self.nearest.pop(check, None)
        self.spread.pop(check, None)

    def choose(self, draws: Draws) -> tuple[KnownRun, float | None]:
        """A run to change, and when it was nearest to failing [s]; None: that is not known."""
        told = sorted(check for check, margins in self.spread.items() if len(margins) > 1)
        if self.novel and (not told or draws.share() < _NOVEL):
            tried: KnownRun = draws.one(self.novel)
            near = [tried.margins[check] for check in told if check in tried.margins]
            return tried, min(near)[1] if near else None
        check = draws.one(told)
        near_ones = self.nearest[check]
        tried = near_ones[int(len(near_ones) * draws.share() ** 2)]  # rather those that are nearer
        return tried, tried.margins[check][1]


class GuidedSearch:
    """Searches for a fault list that makes a check fail."""

    def __init__(self, scenario: Scenario, check: str | None = None, modules: Modules = NO_MODULES) -> None:
        """Prepare it.

        Args:
            scenario: with a nemesis.
            check: which must fail; None: any.
            modules: that its laws need.

        Raises:
            StudyError: it has no nemesis.
        """
        refuse(scenario, "a run of a study")
        if scenario.undrawn.nemesis is None:
            raise StudyError(f"{scenario.name} has no random faults, so all seeds have the same: --nemesis adds some")
        self._scenario, self._check, self._modules = scenario, check, modules
        self._own = len(scenario.undrawn.faults)  # faults of the scenario's own, which stay
        self._text = scenario.to_undrawn_yaml()
        self._next_seed = scenario.seed
        self._corpus = Corpus(check)
        self._fresh: deque[list[Fault]] = deque(maxlen=_KEPT)  # the last lists that seeds drew
        self._number = 0  # of the next generation
        self._found = Searched(scenario.name, scenario.seed, sample=False)
        self._first = ""  # the first scenario that failed

    def run(
        self,
        engine: Engine,
        tell: Callable[[int], None],
        most_runs: float = inf,
        budget_s: float = inf,
        keep: FailureFolder | None = None,
    ) -> Searched:
        """Make generations until a check fails. If several runs of a generation fail, the first one counts.

        Args:
            engine: makes the runs.
            tell: called now and then with the number of runs that were made.
            most_runs: limit on the number of runs. With a folder, earlier runs count.
            budget_s: after this wall time [s] no new generation begins.
            keep: the folder that keeps the first scenario of each kind of failure. The search then goes on after a
                failure. None: it ends at the first failure.

        Raises:
            StudyError: the scenario does not have this check; the folder cannot be used.
        """
        found = self._found = Searched(self._scenario.name, self._scenario.seed, sample=False)
        found.reached = [Reached(name) for name in names_of([self._scenario])]
        file = None if keep is None else GuidedMemoryFile(keep.path, self._scenario.name, self._key)
        rows = {} if file is None else self._goes_on(file)
        until = time.monotonic() + budget_s
        while (made := found.runs + found.without) < most_runs and time.monotonic() < until:
            before = self._memory()
            size = int(min(GENERATION, most_runs - made))
            tasks = self._generation(self._number, size)  # of a part of a generation the first ones
            try:
                self._make(engine, tell, tasks, rows)
            finally:
                if file is not None:
                    before.rows = [rows[task.key] for task, _ in tasks if task.key in rows]
                    file.write(before)
            self._repeat(engine, tell, tasks, rows)
            for task, tree in tasks:
                if self._take(task, tree, rows[task.key], keep) and keep is None:
                    return found
            self._number += size == GENERATION
            rows = {}
        return found

    def _make(
        self, engine: Engine, tell: Callable[[int], None], tasks: list[tuple[Task, Tree]], rows: dict[str, Row]
    ) -> None:
        """Make the runs of a generation that have no row yet."""
        before = self._found.runs + self._found.without

        def take(more: list[Row]) -> None:
            rows.update((row["key"], {name: row[name] for name in row if name.startswith(ROW_KEYS)}) for row in more)
            tell(before + len(rows))

        engine.make((task for task, _ in tasks if task.key not in rows), take, lambda: tell(before + len(rows)))

    def _repeat(
        self, engine: Engine, tell: Callable[[int], None], tasks: list[tuple[Task, Tree]], rows: dict[str, Row]
    ) -> None:
        """Repeat the runs that fail a check that no run before has failed."""
        known, made = set(self._found.kinds), self._found.runs + self._found.without + len(rows)
        for task, _ in tasks:
            row, repeats = rows[task.key], list[Row]()
            failed = failed_checks(row) if row["status"] in JUDGED else []
            if {check for check in failed if self._check in (None, check)} - known:
                engine.make(iter([repeat_of(task)]), repeats.extend, lambda: tell(made))
                rows[task.key] = row = compared(row, repeats[0])
                known.update(failed if row["status"] in JUDGED else [])

    def _take(self, task: Task, tree: Tree, row: Row, keep: FailureFolder | None) -> list[str]:
        """Count a run; returns the checks that it fails."""
        found = self._found
        for one in found.reached:
            one.count(row)
        failed = failures_of(found, row, self._check)
        for check in failed if keep is not None else failed[:1]:
            if check in found.kinds:
                continue
            found.kinds[check] = task.seed
            if found.scenario is None:
                found.seed, found.check, found.scenario, self._first = task.seed, check, scenario_of(task), task.text
            if keep is not None:
                self._corpus.leave(check)
                _keep(keep, scenario_of(task), check, row)
        self._corpus.take(self._tried(tree, row), row.get("seen", []))
        return failed

    @property
    def _key(self) -> str:
        return run_key(f"{self._text}\nseed {self._scenario.seed} check {self._check or ''} guide")

    def _memory(self) -> GuidedMemory:
        """All that determines the generations to come."""
        corpus, found = self._corpus, self._found
        return GuidedMemory(
            key=self._key,
            number=self._number,
            next_seed=self._next_seed,
            nearest={check: [*near] for check, near in corpus.nearest.items()},
            novel=[*corpus.novel],
            seen=sorted(corpus.seen),
            spread={check: sorted(margins)[:2] for check, margins in corpus.spread.items()},
            failed=sorted(corpus.failed),
            fresh=[*self._fresh],
            runs=found.runs,
            without=found.without,
            reason=found.reason,
            kinds=dict(found.kinds),
            reached={one.name: (one.runs, one.hits, one.seed) for one in found.reached},
            first=None if found.seed is None else (self._first, found.seed, found.check),
        )

    def _goes_on(self, file: GuidedMemoryFile) -> dict[str, Row]:
        """Go on from what a folder has; returns the rows of a generation that was not whole, by key."""
        if (known := file.read()) is None:
            return {}
        corpus, found = self._corpus, self._found
        try:
            for one in [*known.novel, *(one for near in known.nearest.values() for one in near)]:
                scenario_of(self._task(json.dumps(one.tree), one.tree["seed"]))
            for faults in known.fresh:
                scenario_of(self._task(json.dumps({**tree_of(self._scenario), "faults": faults}), self._scenario.seed))
            if known.first is not None:
                self._first, found.seed, found.check = known.first
                found.scenario = scenario_of(self._task(self._first, found.seed))
        except (ScenarioError, KeyError, TypeError) as error:
            raise StudyError(f"{file.path} is damaged: {error!s:.200}") from None
        corpus.nearest, corpus.seen, corpus.failed = known.nearest, set(known.seen), set(known.failed)
        corpus.novel.extend(known.novel)
        corpus.spread = {check: set(margins) for check, margins in known.spread.items()}
        self._number, self._next_seed = known.number, known.next_seed
        self._fresh.extend(known.fresh)
        found.runs, found.without, found.reason, found.kinds = known.runs, known.without, known.reason, known.kinds
        for reached in found.reached:
            reached.runs, reached.hits, reached.seed = known.reached.get(reached.name, (0, 0, None))
        return {row["key"]: row for row in known.rows if "key" in row}

    def _generation(self, number: int, size: int) -> list[tuple[Task, Tree]]:
        tasks: dict[str, tuple[Task, Tree]] = {}
        for slot in range(size):
            for attempt in range(_TRIES):
                draws = Draws(self._scenario.seed, number, slot, attempt)
                fresh = not (self._corpus.novel or self._corpus.nearest) or draws.share() < _FRESH
                task, tree = self._seeded() if fresh else self._moved(draws)
                if task is not None and task.key not in tasks:
                    break
            else:
                task, tree = self._seeded()
            assert task is not None
            tasks[task.key] = task, tree
        return list(tasks.values())

    def _seeded(self) -> tuple[Task, Tree]:
        """The next seed, as in a search without a guide."""
        task = self._task(self._text, self._next_seed)
        self._next_seed = self._next_seed + 1 if self._next_seed < LARGEST_SEED else 0
        tree = tree_of(scenario_of(task))
        self._fresh.append(self._drawn(tree))
        return task, tree

    def _moved(self, draws: Draws) -> tuple[Task | None, Tree]:
        """A list of the corpus, changed; None: it is no valid scenario."""
        scenario = self._scenario
        parent, at_s = self._corpus.choose(draws)
        others = [tried.drawn for tried in self._corpus.novel]
        others += [tried.drawn for near in self._corpus.nearest.values() for tried in near]
        others += self._fresh
        latest = max((end_of(fault, scenario.duration_ns) for faults in others for fault in faults), default=0)
        mutator = Mutator(scenario, latest)
        near_ns = None if at_s is None else round(at_s * 1e9)
        drawn = mutator.mutated(parent.drawn, others, near_ns, draws)
        # Its own seed keeps what the parent met on its network; another one makes the same faults meet other losses.
        seed = parent.tree["seed"] if draws.share() < 0.7 else draws.below(LARGEST_SEED)
        own = (parent.tree.get("faults") or [])[: self._own]
        tree = {**parent.tree, "seed": seed, "faults": [*own, *drawn]}
        task = self._task(json.dumps(tree), seed)
        try:
            scenario_of(task)
        except ScenarioError:
            return None, tree
        return task, tree

    def _task(self, text: str, seed: int) -> Task:
        key = run_key(f"{text}\nseed {seed}")
        return Task(key, 0, seed, self._scenario.name, text, inf, self._modules, seen=True)

    def _drawn(self, tree: Tree) -> list[Fault]:
        return list((tree.get("faults") or [])[self._own :])

    def _tried(self, tree: Tree, row: Row) -> KnownRun:
        margins: dict[str, tuple[float, float | None]] = {}
        for name, value in row.items():
            if name.startswith("margin.") and isfinite(value):
                check = name.removeprefix("margin.")
                margins[check] = value, row.get(f"at.{check}")
        return KnownRun(tree, self._drawn(tree), margins)


def _keep(folder: FailureFolder, scenario: Scenario, check: str, row: Row) -> None:
    """Keep a failure, unless the folder has one of its kind."""
    file, value = file_of(scenario, check), row.get(f"value.{check}")
    if all(one.file != file for one in folder.failures()):
        found = "" if value is None else f"{value:.4g}"
        folder.add(FoundFailure(file=file, check=check, seed=row["seed"], digest=row["digest"], found=found,
                                version=row["version"]), scenario)  # fmt: skip
