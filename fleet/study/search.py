"""The first seed that fails: a scenario run with one seed after the other, until a check fails.

The seed decides which faults a nemesis draws, and every fate and noise. Seeds are given out in their order, and a seed
that fails ends the search when those before it are done; so the first one is found however many workers there are.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from math import inf
from typing import Literal

from fleet.execution.external_agents import refuse
from fleet.scenario.scenario import Scenario
from fleet.scenario.text.overrides import SET, Override
from fleet.study.engine import Engine, Row
from fleet.study.errors import StudyError
from fleet.study.modules import NO_MODULES, Modules
from fleet.study.one_run import JUDGED, Task, failed_checks, scenario_of
from fleet.study.plan import run_key
from fleet.study.spec import LARGEST_SEED
from fleet.study.statistics import most_failures


@dataclass(slots=True)
class Searched:
    """What a search came to.

    Attributes:
        first_seed: the first one that was tried.
        seed: the first one that fails; None: none did.
        check: that fails with it; empty: none.
        scenario: that fails.
        runs: that were judged, later ones that were under way with the first one that fails included.
        without: runs without a result.
        reason: of the first of these.
        sample: whether the runs were drawn one like the other, so that they tell what others would do.
    """

    name: str  # of the scenario
    first_seed: int
    seed: int | None = None
    check: str = ""
    scenario: Scenario | None = None
    runs: int = 0
    without: int = 0
    reason: str = ""
    sample: bool = True

    @property
    def most_failures(self) -> float | None:
        """The share of such runs that fails at most, 95 % sure, since none of these did; None: that is not so."""
        return most_failures(self.runs) if self.runs and self.seed is None and self.sample else None


def nemesis_of(scenario: Scenario, mode: Literal["swarm", "liveness"] = "swarm") -> Override:
    """A nemesis for a scenario that has none, as a change of it.

    Raises:
        StudyError: it has one.
    """
    if scenario.undrawn.nemesis is not None:
        raise StudyError(f"{scenario.name} has a nemesis: change it with --set nemesis.mode={mode} and the like")
    return Override(SET, f"nemesis={mode}")


def search(
    scenario: Scenario,
    engine: Engine,
    tell: Callable[[int], None],
    *,
    check: str | None = None,
    most_runs: float = inf,
    budget_s: float = inf,
    modules: Modules = NO_MODULES,
) -> Searched:
    """Run a scenario with its own seed, the next one and so on, until a check fails.

    Args:
        tell: called now and then with the number of runs that were made.
        check: which must fail; None: any.
        most_runs: how many seeds are tried.
        budget_s: of wall time, after which no run is begun.
        modules: that its laws need.

    Raises:
        StudyError: it has no nemesis, or not this check.
    """
    refuse(scenario, "a run of a study")
    if scenario.undrawn.nemesis is None:
        raise StudyError(f"{scenario.name} has no nemesis that another seed would change: --nemesis adds one")
    found = Searched(scenario.name, scenario.seed)
    failing: dict[int, str] = {}  # check by seed
    text, until = scenario.to_undrawn_yaml(), time.monotonic() + budget_s

    def task(seed: int) -> Task:
        return Task(run_key(f"{text}\nseed {seed}"), 0, seed, scenario.name, text, inf, modules)

    def tasks() -> Iterator[Task]:
        for seed in count(found.first_seed):
            over = seed > LARGEST_SEED or seed - found.first_seed >= most_runs or time.monotonic() > until
            if failing or over:
                return
            yield task(seed)

    def take(rows: list[Row]) -> None:
        for row in rows:
            if failed := failed_of(found, row, check):
                failing[row["seed"]] = failed
        tell(found.runs + found.without)

    engine.make(tasks(), take, lambda: tell(found.runs + found.without))
    if failing:
        found.seed = min(failing)
        found.check = failing[found.seed]
        found.scenario = scenario_of(task(found.seed))
    return found


def failed_of(found: Searched, row: Row, check: str | None) -> str:
    """Count a run; returns the check that it fails, or an empty text.

    Args:
        check: which must fail; None: any.

    Raises:
        StudyError: the scenario does not have this check.
    """
    if row["status"] not in JUDGED:
        found.without += 1
        found.reason = found.reason or row["reason"]
        return ""
    found.runs += 1
    failed = failed_checks(row)
    if check is None:
        return failed[0] if failed else ""
    if f"check.{check}" not in row:
        raise StudyError(f"{found.name} has no check {check}")
    return check if check in failed else ""
