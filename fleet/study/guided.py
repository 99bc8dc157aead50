"""A guided search: fault lists that brought a check near to failing, or a run to something new, are changed further.

Runs come in generations of a fixed size. A generation is made from what all generations before it found, by keyed
draws, so what is found does not depend on how many workers there are. A quarter of a generation are seeds as in a plain
search. The rest are moves (`moves`) on lists of a corpus. That has, for each check, the lists with the smallest
margins, and those that went through something new (`seen`).
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import NamedTuple

from fleet.errors import ScenarioError
from fleet.execution.external_agents import refuse
from fleet.scenario.scenario import Scenario
from fleet.study.engine import Engine, Row
from fleet.study.errors import StudyError
from fleet.study.modules import NO_MODULES, Modules
from fleet.study.moves import Draws, Fault, Mutator, end_of
from fleet.study.one_run import Task, scenario_of
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


class ChangedRun(NamedTuple):
    """A run that was made."""

    tree: Tree
    drawn: list[Fault]  # its faults but those that the scenario has itself
    margins: dict[str, tuple[float, float | None]]  # by check: the margin, and when it was least [s]


@dataclass(slots=True)
class Corpus:
    """The fault lists that are worth changing."""

    check: str | None  # which must fail; None: any
    nearest: dict[str, list[ChangedRun]] = field(default_factory=dict)  # by check, the smallest margin first
    novel: deque[ChangedRun] = field(default_factory=lambda: deque(maxlen=_KEPT))
    seen: set[int] = field(default_factory=set)
    spread: dict[str, set[float]] = field(default_factory=dict)  # margins of a check: one alone tells nothing

    def take(self, tried: ChangedRun, features: list[int]) -> None:
        """Keep a run if it is near to failing, or new."""
        if not self.seen.issuperset(features):
            self.seen.update(features)
            self.novel.append(tried)
        for check, (margin, _) in tried.margins.items():
            if self.check not in (None, check):
                continue
            self.spread.setdefault(check, set()).add(margin)
            near = self.nearest.setdefault(check, [])
            near.append(tried)
            near.sort(key=lambda one: one.margins[check][0])  # stable: of equal ones the first
            del near[_KEPT:]

    def choose(self, draws: Draws) -> tuple[ChangedRun, float | None]:
        """A run to change, and when it was nearest to failing [s]; None: that is not known."""
        told = sorted(check for check, margins in self.spread.items() if len(margins) > 1)
        if self.novel and (not told or draws.share() < _NOVEL):
            tried: ChangedRun = draws.one(self.novel)
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
            raise StudyError(f"{scenario.name} has no nemesis that another seed would change: --nemesis adds one")
        self._scenario, self._check, self._modules = scenario, check, modules
        self._own = len(scenario.undrawn.faults)  # faults of the scenario's own, which stay
        self._text = scenario.to_undrawn_yaml()
        self._next_seed = scenario.seed
        self._corpus = Corpus(check)
        self._fresh: deque[list[Fault]] = deque(maxlen=_KEPT)  # the last lists that seeds drew

    def run(
        self, engine: Engine, tell: Callable[[int], None], most_runs: float = inf, budget_s: float = inf
    ) -> Searched:
        """Make generations until a check fails. If several runs of a generation fail, the first one counts.

        Args:
            tell: called now and then with the number of runs that were made.
            most_runs: how many there may be.
            budget_s: of wall time, after which no generation is begun.

        Raises:
            StudyError: the scenario does not have this check.
        """
        found = Searched(self._scenario.name, self._scenario.seed, sample=False)
        found.reached = [Reached(name) for name in names_of([self._scenario])]
        until, made, number = time.monotonic() + budget_s, 0, 0
        while made < most_runs and time.monotonic() < until:
            tasks = self._generation(number, int(min(GENERATION, most_runs - made)))
            rows: dict[str, Row] = {}

            def take(more: list[Row], rows: dict[str, Row] = rows) -> None:
                rows.update((row["key"], row) for row in more)
                tell(found.runs + found.without + len(rows))

            engine.make(iter([task for task, _ in tasks]), take, lambda: tell(found.runs + found.without))
            for task, tree in tasks:
                row = rows[task.key]
                for one in found.reached:
                    one.count(row)
                if failed := failures_of(found, row, self._check):
                    found.seed, found.check, found.scenario = task.seed, failed[0], scenario_of(task)
                    found.kinds = {failed[0]: task.seed}
                    return found
                self._corpus.take(self._tried(tree, row), row.get("seen", []))
            made, number = made + len(tasks), number + 1
        return found

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

    def _tried(self, tree: Tree, row: Row) -> ChangedRun:
        margins: dict[str, tuple[float, float | None]] = {}
        for name, value in row.items():
            if name.startswith("margin.") and isfinite(value):
                check = name.removeprefix("margin.")
                margins[check] = value, row.get(f"at.{check}")
        return ChangedRun(tree, self._drawn(tree), margins)
