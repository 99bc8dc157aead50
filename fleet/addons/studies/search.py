"""The first seed that fails: a scenario run with one seed after the other, until a check fails.

The seed decides which faults a nemesis draws, and every fate and noise. Seeds are given out in their order, and a seed
that fails ends the search when those before it are done; so the first one is found however many workers there are.
A run that fails a check which no run before has failed is repeated (`confirmed`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from math import inf
from pathlib import Path
from typing import Literal

from msgspec import structs

from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.failures import FailureFolder, FoundFailure, SearchProgress, file_of
from fleet.addons.studies.modules import NO_MODULES, Modules
from fleet.addons.studies.one_run import Task, scenario_of, with_triggers_resolved
from fleet.addons.studies.plan import run_key
from fleet.addons.studies.row import FAILED, VOTES, Covered, Reached, Row, majority, sometimes_names
from fleet.addons.studies.spec import LARGEST_SEED
from fleet.addons.studies.statistics import most_failures
from fleet.analysis.randomness import may_draw
from fleet.execution.external_agents import refuse
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections import episodes
from fleet.scenario.sections.triggers import moments
from fleet.scenario.text.overrides import SET, Override

_SAVE_S = 2.0  # how often a search writes how far it is


def coverage(scenario: Scenario, seeds: Collection[int]) -> Covered | None:
    """The episodes of a scenario's runs with some seeds. None: its nemesis draws no episodes."""
    nemesis = scenario.undrawn.nemesis
    if nemesis is None or nemesis.mode != "episodes":
        return None
    plan, n = episodes.plan(nemesis, scenario.targets), scenario.vehicles
    count = len(seeds) * len(plan.begins)
    cuts_off = nemesis.pick is None or any(pick.drawn == "partition" for pick in nemesis.pick)
    two, three = (episodes.chance(isolations, n, count) if cuts_off else None for isolations in (2, 3))
    kinds, faults = (dict(found.most_common()) for found in episodes.count_episodes(nemesis, scenario.targets, seeds))
    return Covered(count, kinds, faults, plan.unit / 1e9, plan.origin, two, three)


@dataclass(slots=True)
class SearchResult:
    """The result of a search."""

    name: str  # of the scenario
    first_seed: int
    seed: int | None = None  # the first seed that fails; None: no run failed
    check: str = ""  # that fails with this seed
    scenario: Scenario | None = None
    runs: int = 0  # that were judged, with those under way when the first failure came
    without: int = 0  # runs without a result
    reason: str = ""  # why the first of these has none
    kinds: dict[str, int] = field(default_factory=dict)  # the first seed by check; without a folder only one
    reached: list[Reached] = field(default_factory=list)  # the checks that some run must reach
    votes: dict[str, tuple[int, int]] = field(default_factory=dict)  # on the wall clock: runs that fail a check, of all
    unstated: dict[str, int] = field(default_factory=dict)  # a seed by check that failed and is not looked for
    triggered: dict[str, str] = field(default_factory=dict)  # what began a fault of `scenario`, by the fault's id
    covered: Covered | None = None

    @property
    def most_failures(self) -> float | None:
        """Upper 95 % bound on the failure rate if no run failed; None otherwise.

        If some run must reach a place and none did, they say nothing about runs that would.
        """
        missed = any(not one.hits for one in self.reached)
        known = self.runs and self.seed is None and not missed
        return most_failures(self.runs) if known else None


def nemesis_of(scenario: Scenario, mode: Literal["swarm", "episodes", "liveness"] = "swarm") -> Override:
    """A nemesis for a scenario that has none, as a change of it. Raises StudyError: it has one."""
    if scenario.undrawn.nemesis is not None:
        raise StudyError(f"{scenario.name} already has a nemesis: change that one, as with --set nemesis.mode={mode}")
    return Override(SET, f"nemesis={mode}")


def search(
    scenario: Scenario,
    engine: Engine,
    on_progress: Callable[[int], None],
    *,
    check: str | None = None,
    most_runs: float = inf,
    budget_s: float = inf,
    modules: Modules = NO_MODULES,
    keep: FailureFolder | None = None,
) -> SearchResult:
    """Run a scenario with its own seed, the next one and so on, until a check fails. `on_progress`: called with the
    number of runs so far. `check`: only this one ends it; None: any that the scenario states. `budget_s`: after this
    wall time no run begins. `keep`: keeps the first scenario of each kind of failure; then the search goes on after a
    failure, and runs of before count. Raises StudyError: the scenario draws nothing, or has not this check; or the
    folder cannot be used."""
    refuse(scenario, "a run of a study", stacks=True)
    if scenario.undrawn.nemesis is None and not may_draw(scenario):
        raise StudyError(f"{scenario.name} draws nothing at random, so all seeds are the same: --nemesis adds faults")
    text, until = scenario.to_undrawn_yaml(), time.monotonic() + budget_s
    work = _Search(scenario, text, check, modules, keep)

    def tasks() -> Iterator[Task]:
        for seed in count(work.next_seed):
            yield from work.repeats()
            over = seed > LARGEST_SEED or seed - scenario.seed >= most_runs or time.monotonic() > until
            if over or (keep is None and work.failing):
                return
            if seed not in work.waiting:
                yield work.task(seed)

    def take(rows: list[Row]) -> None:
        for row in rows:
            work.take(row)
        on_progress(work.made)

    try:
        engine.make(tasks(), take, lambda: on_progress(work.made))
        while work.doubt is not None:
            engine.make(tasks(), take, lambda: on_progress(work.made))
    finally:
        work.save()
    return work.end()


class _Search:
    """A search that goes on. Rows are counted in the order of their seeds, so nothing depends on who made them."""

    def __init__(
        self, scenario: Scenario, text: str, check: str | None, modules: Modules, keep: FailureFolder | None
    ) -> None:
        self._scenario, self._text, self._check, self._modules, self._keep = scenario, text, check, modules, keep
        self._unstated = scenario.spec.checks.unstated
        where = Path("runs") if keep is None else keep.path
        self._place = str(where.resolve() / f"{scenario.name}-search") if modules.programs else ""
        self.found = SearchResult(scenario.name, scenario.seed)
        self.found.reached = [Reached(name) for name in sometimes_names([scenario])]
        self.next_seed = scenario.seed
        self.waiting: dict[int, Row] = {}  # rows behind a seed that has none yet
        self.doubt: int | None = None  # the next seed, if its run fails and is being repeated
        self._repeats: list[Task] = []  # that no worker has yet
        self._times = VOTES if modules.programs else 1  # that a run is repeated which fails in a new way
        self._again: list[Row] = []  # its repetitions so far
        self._sure: set[int] = set()  # seeds whose run was repeated
        self.failing = False  # whether a run has failed, perhaps behind such a seed
        if keep is not None:
            self._goes_on(keep)
        self._saved = time.monotonic()

    @property
    def made(self) -> int:
        return self.found.runs + self.found.without + len(self.waiting)

    def repeats(self) -> Iterator[Task]:
        """The runs that are to be repeated; each is given once."""
        while self._repeats:
            yield self._repeats.pop()

    def task(self, seed: int) -> Task:
        return Task(run_key(f"{self._text}\nseed {seed}"), 0, seed, self._scenario.name, self._text, inf, self._modules,
                    keep=self._place, bare=True)  # fmt: skip

    def take(self, row: Row) -> None:
        """Take a row. Count the rows that are next in order, until one fails in a new way: it is repeated first."""
        seed = row.seed
        if seed == self.doubt:
            self._again.append(row)
            if len(self._again) < self._times:
                return
            row, self.doubt = self._decided(self.waiting[seed], self._again), None
            self._again = []
            self._sure.add(seed)
        self.waiting[seed] = row
        self.failing = bool(self.found.kinds) or any(self._fails(row) for row in self.waiting.values())
        while self.doubt is None and (known := self.waiting.get(self.next_seed)) is not None:
            if self._is_new(known):
                self.doubt, again = self.next_seed, self.task(self.next_seed)
                self._repeats += [
                    again._replace(key=run_key(f"{again.key}\nagain{'' if n == 0 else n}"), bare=False)
                    for n in range(self._times)
                ]
                break
            self._count(self.waiting.pop(self.next_seed))
            self.next_seed += 1
        if self._keep is not None and time.monotonic() - self._saved > _SAVE_S:
            self.save()

    def _decided(self, row: Row, again: Sequence[Row]) -> Row:
        """What counts of a run that failed and was repeated: always the same in lockstep, and on the wall clock what
        most runs came to.
        """
        if self._times == 1:
            return row.compare(again[0])
        rows, known = [row, *again], self.found.kinds.keys()
        votes = {check: majority(rows, check)[1:] for check in self._fails(row) if check not in known}
        sure = {check: vote for check, vote in votes.items() if 2 * vote[0] > vote[1]}
        if not sure and not known & set(row.failed_checks):
            check, (failed, of) = next(iter(votes.items()))
            reason = f"seed {row.seed} failed {check} in {failed} of {of} runs, which is too seldom to look into"
            return structs.replace(row, status=FAILED, reason=reason, passed=None, checks={}, numbers={})
        self.found.votes |= sure
        most = max(rows, key=lambda one: len(sure.keys() & set(one.failed_checks)))
        counts = {*sure, *known, *self._unstated}
        checks = {name: check for name, check in most.checks.items() if check.passed is not False or name in counts}
        return structs.replace(most, checks=checks)

    def _is_new(self, row: Row) -> bool:
        if row.seed in self._sure or (self._keep is None and self.found.kinds):
            return False
        return bool(set(self._fails(row)) - self.found.kinds.keys())

    def _fails(self, row: Row) -> list[str]:
        failed = row.failed_checks if row.judged else []
        if self._check is not None:
            return [check for check in failed if check == self._check]
        return [check for check in failed if check not in self._unstated]

    def save(self) -> None:
        if self._keep is None:
            return
        found = self.found
        reached = {one.name: (one.runs, one.hits, one.seed) for one in found.reached}
        self._keep.save(
            self._scenario,
            SearchProgress(key=self._key, first_seed=found.first_seed, next_seed=self.next_seed, runs=found.runs,
                  without=found.without, reason=found.reason, kinds=found.kinds, reached=reached),
        )  # fmt: skip
        self._saved = time.monotonic()

    def end(self) -> SearchResult:
        """The result of the search.

        Without a folder runs that were under way with the first failing one count as well.
        """
        found = self.found
        seeds = [*range(found.first_seed, self.next_seed)]
        if self._keep is None:
            for seed in sorted(self.waiting):
                self._count(self.waiting[seed])
                seeds.append(seed)
        if found.kinds:
            found.check = min(found.kinds, key=lambda check: found.kinds[check])
            found.seed = found.kinds[found.check]
            spec = scenario_of(self.task(found.seed)).spec
            found.scenario, found.triggered = self.scenario(found.seed), moments(spec.triggers, spec)
        found.covered = coverage(self._scenario, seeds)
        return found

    def scenario(self, seed: int) -> Scenario:
        return with_triggers_resolved(self.task(seed))

    @property
    def _key(self) -> str:
        return run_key(f"{self._text}\ncheck {self._check or ''}")

    def _goes_on(self, keep: FailureFolder) -> None:
        tried, found = keep.tried(self._scenario, self._key), self.found
        found.first_seed, self.next_seed = tried.first_seed, tried.next_seed
        found.runs, found.without, found.reason, found.kinds = tried.runs, tried.without, tried.reason, tried.kinds
        for one in found.reached:
            one.runs, one.hits, one.seed = tried.reached.get(one.name, (0, 0, None))

    def _count(self, row: Row) -> None:
        seed, failed = row.seed, list[str]()
        if row.judged:
            self.found.runs += 1
            if self._check is not None and self._check not in row.checks:
                raise StudyError(f"{self.found.name} has no check {self._check}")
            failed = self._fails(row)
            for check in self._unstated.intersection(row.failed_checks if self._check is None else ()):
                self.found.unstated.setdefault(check, seed)
        else:
            self.found.without += 1
            self.found.reason = self.found.reason or row.reason
        for one in self.found.reached:
            one.count(row)
        for check in failed if self._keep is not None else failed[:1]:
            if check in self.found.kinds or (self._keep is None and self.found.kinds):
                continue
            self.found.kinds[check] = seed
            if self._keep is not None:
                scenario = self.scenario(seed)
                file = file_of(scenario, check)
                if all(one.file != file for one in self._keep.failures()):
                    value = row.checks[check].value
                    self._keep.add(
                        FoundFailure(file=file, check=check, seed=seed, digest=row.digest or "", from_seed=seed,
                                found="" if value is None else f"{value:.4g}", version=row.version),
                        scenario,
                    )  # fmt: skip
