"""The scenarios of a folder of failures, run again: is each verdict still the expected one?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from math import inf

from fleet.execution.external_agents import refuse
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import READING, Policy
from fleet.study.engine import Engine, Row
from fleet.study.errors import StudyError
from fleet.study.failures import FailureFolder, FoundFailure
from fleet.study.modules import Modules, modules_of
from fleet.study.one_run import A_STUDY, JUDGED, Task, failed_checks
from fleet.study.plan import run_key
from fleet.study.shrink import Shrinker


@dataclass(frozen=True, slots=True)
class Regressed:
    """One scenario of a folder that was run again.

    Attributes:
        failure: the scenario, with the expected verdict.
        got: the verdict now, in words.
        same: whether it is the expected verdict.
        broken: whether the run has no verdict.
        differs: whether the same version of fleet made another log. A change of its code cannot be the reason.
        wall_s: duration of the run [s].
    """

    failure: FoundFailure
    got: str
    same: bool
    broken: bool
    differs: bool
    wall_s: float


class Regression:
    """The scenarios of a folder, read and ready to run."""

    def __init__(self, folder: FailureFolder) -> None:
        """Read every scenario.

        Raises:
            ScenarioError: one of them has mistakes, or a law that may not run.
            StudyError: the folder is damaged, or holds nothing.
        """
        self._folder, self.failures = folder, folder.failures()
        if not self.failures:
            raise StudyError(f"{folder.path} holds no failures: fleet search SCENARIO --keep {folder.path} fills it")
        policy = Policy(A_STUDY)
        self._scenarios = [folder.load(failure, policy) for failure in self.failures]
        for scenario in self._scenarios:
            refuse(scenario, "a run of a study")
        self.modules = modules_of(self._scenarios, folder.path)

    def run(
        self, engine: Engine, tell: Callable[[int], None], modules: Modules, timeout_s: float = inf
    ) -> list[Regressed]:
        """Run them all; returns what came out, in the order of the folder.

        Args:
            tell: called now and then with the number of runs that were made.
            modules: that the runs need, as the engine carries them.
            timeout_s: of wall time, for one run.
        """
        rows: dict[int, Row] = {}

        def tasks() -> Iterator[Task]:
            for number, (failure, scenario) in enumerate(zip(self.failures, self._scenarios, strict=True)):
                text = scenario.to_undrawn_yaml()
                key = run_key(f"{text}\nseed {failure.seed}")
                yield Task(key, number, failure.seed, scenario.name, text, timeout_s, modules)

        def take(made: list[Row]) -> None:
            rows.update({row["point"]: row for row in made})
            tell(len(rows))

        engine.make(tasks(), take, lambda: tell(len(rows)))
        return [_compared(failure, rows[number]) for number, failure in enumerate(self.failures)]

    def accept(self, found: list[Regressed]) -> int:
        """Expect from now on what came out; returns how many of them changed. Raises StudyError."""
        changed = [one.failure for one in found if not one.same and not one.broken]
        for failure in changed:
            failure.expected = "pass" if failure.expected == "fail" else "fail"
        self._folder.update(self.failures)
        return len(changed)


def _compared(failure: FoundFailure, row: Row) -> Regressed:
    wall_s = float(row.get("wall_s") or 0.0)
    if row["status"] not in JUDGED:
        return Regressed(failure, f"no result: {row['reason']}", False, True, False, wall_s)
    failed = failed_checks(row)
    fails = failure.check in failed
    same = fails if failure.expected == "fail" else not failed
    got = f"fails {', '.join(failed)}" if failed else "passes"
    differs = row["version"] == failure.version and row["digest"] != failure.digest
    return Regressed(failure, got, same, False, differs, wall_s)


def make_least(
    folder: FailureFolder,
    scenario: Scenario,
    engine: Engine,
    tell: Callable[[str, int], None],
    modules: Modules,
    most_runs: int,
) -> list[FoundFailure]:
    """Make the failures in a folder as small as possible, unless that is done already.

    Args:
        folder: the folder of failures.
        scenario: the scenario of the search that found them.
        engine: makes the runs.
        tell: called now and then with the present step, in words, and the number of runs made.
        modules: the modules of its laws.
        most_runs: limit on the runs for each failure.

    Returns:
        The failures that were made smaller.

    Raises:
        StudyError: a failure cannot be read or written.
    """
    done = []
    for failure in folder.of(scenario):
        if failure.least or failure.expected != "fail":
            continue
        first = folder.load(failure, READING)  # workers import its laws, as they did when it was found
        found = Shrinker(first, engine, tell, modules).shrink(failure.check, most_runs)
        least = FoundFailure(file=failure.file, check=failure.check, seed=found.scenario.seed, digest=found.digest,
                        found=found.found[1], from_seed=failure.from_seed, least=True,
                        version=version("uuv-fleet"))  # fmt: skip
        done.append(folder.add(least, found.scenario))
    return done
