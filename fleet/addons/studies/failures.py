"""A folder of failures: one small scenario per kind of failure, with what is expected of it.

```text
DIR/NAME-CHECK.yaml    a scenario with explicit faults; `fleet run` runs it
DIR/failures.json      of each: seed, check, expected verdict, digest of its log, and a line to paste
DIR/NAME.search.json   how far the search of the scenario NAME is, so that it can go on
```

A kind of failure is the check that fails. `fleet search --keep DIR` fills the folder, `fleet regress DIR` runs it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct

from fleet.addons.studies.engine_interface import Engine
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import Modules, modules_of
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.plan import run_key
from fleet.addons.studies.row import VOTES, Row, majority
from fleet.addons.studies.shrink import Shrinker
from fleet.execution.external_agents import refuse, uses_wall_clock
from fleet.scenario.loading import load_scenario
from fleet.scenario.scenario import Scenario
from netem.files import DamagedFile, read_json
from netem.limits import FAILURES
from netem.whole_file import write_whole

INDEX = "failures.json"
FORMAT = 1  # of both JSON files
_S = TypeVar("_S", bound=Struct)
FileName = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,200}\.yaml$")]


class FoundFailure(Struct, kw_only=True):
    """One scenario of the folder, and what is expected of it."""

    file: FileName
    check: str  # that fails, or that failed when it was found
    expected: Literal["fail", "pass"] = "fail"  # pass: once it is mended, every check has to pass
    seed: int
    digest: str  # of the log of its run
    found: str = ""  # what the verdict said, in words
    from_seed: int | None = None  # with which the search found it
    least: bool = False  # whether it was made as small as it can be
    version: str = ""  # of fleet, that made the digest
    paste: str = ""  # the line to paste


class _Index(Struct):
    format: int
    failures: Annotated[list[FoundFailure], Meta(max_length=FAILURES.items)]


class SearchProgress(Struct, kw_only=True):
    """How far a search is: all seeds from the first one on, up to but without the next one, were run."""

    format: int = FORMAT
    key: str  # of the scenario without its seed
    first_seed: int
    next_seed: int
    runs: int = 0
    without: int = 0
    reason: str = ""
    kinds: dict[str, int] = {}  # by check, the first seed that fails it
    reached: dict[str, tuple[int, int, int | None]] = {}  # by check with `sometimes`: runs, hits, least seed


class FailureFolder:
    """The folder. It may come from anybody, so that what it holds is read with bounds."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def failures(self) -> list[FoundFailure]:
        """The folder's entries about its scenarios. Raises StudyError: it is damaged."""
        index = self._read(self.path / INDEX, _Index)
        return [] if index is None else index.failures

    def of(self, scenario: Scenario) -> list[FoundFailure]:
        """The folder's entry by the search of a scenario. Raises StudyError: it is damaged."""
        return [one for one in self.failures() if one.file == file_of(scenario, one.check)]

    def add(self, failure: FoundFailure, scenario: Scenario) -> FoundFailure:
        """Write a scenario and what is expected of it, in place of what was there of this name. Raises StudyError: it
        cannot be written."""
        path = self.path / failure.file
        if uses_wall_clock(scenario):  # whose log never comes out the same again
            failure.digest = ""
        self._write(path, scenario.to_yaml().encode())
        failure.paste = self.paste(failure)
        self.update([*(one for one in self.failures() if one.file != failure.file), failure])
        return failure

    def paste(self, failure: FoundFailure) -> str:
        """The line that runs a failure, with what comes of it."""
        verdict = f"fails {failure.check}" if failure.expected == "fail" else "passes"
        if not failure.digest:  # of programs on the wall clock
            verb = "netem" if self.load(failure, imports=False).nodes else "run"
            return f"fleet {verb} {self.path / failure.file} --seed {failure.seed}  # {verdict}"
        return f"fleet run {self.path / failure.file} --seed {failure.seed}  # {verdict}, sha256 {failure.digest[:16]}"

    def load(self, failure: FoundFailure, *, imports: bool = True) -> Scenario:
        """One of its scenarios; `imports` the laws that it names. Raises ScenarioError: with every mistake that was
        found, or it cannot be read; StudyError: it is not there."""
        path = self.path / failure.file
        if not path.is_file():
            raise StudyError(f"{path} is no file, and {INDEX} names it")
        return load_scenario(path, [f"seed={failure.seed}"], imports=imports)

    def update(self, failures: list[FoundFailure]) -> None:
        """Write what is expected. Raises StudyError."""
        index = _Index(FORMAT, sorted(failures, key=lambda one: one.file))
        self._write(self.path / INDEX, msgspec.json.format(msgspec.json.encode(index), indent=1) + b"\n")

    def tried(self, scenario: Scenario, key: str) -> SearchProgress:
        """How far the search of a scenario is. `key`: of the scenario without its seed. Raises StudyError: it is
        damaged, or was made of another scenario of this name."""
        path = self._progress(scenario)
        tried = self._read(path, SearchProgress)
        if tried is None:
            return SearchProgress(key=key, first_seed=scenario.seed, next_seed=scenario.seed)
        if tried.key != key:
            raise StudyError(f"{path} belongs to another {scenario.name}: choose another folder, or remove that file")
        return tried

    def save(self, scenario: Scenario, tried: SearchProgress) -> None:
        """Write how far a search is. Raises StudyError."""
        self._write(self._progress(scenario), msgspec.json.encode(tried))

    def _progress(self, scenario: Scenario) -> Path:
        return self.path / f"{scenario.name}.search.json"

    def _read(self, path: Path, kind: type[_S]) -> _S | None:
        try:
            found = read_json(path, kind, FAILURES.bytes)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StudyError(f"{path} cannot be read: {error.strerror}") from None
        except DamagedFile as error:
            raise StudyError(f"{path} is damaged: {error!s:.200}") from None
        if (version := getattr(found, "format", FORMAT)) != FORMAT:
            raise StudyError(f"{path} has format {version}, expected {FORMAT}: a later fleet wrote it")
        return found

    def _write(self, path: Path, data: bytes) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            write_whole(path, data, 0o666)
        except OSError as error:
            raise StudyError(f"{path} cannot be written: {error.strerror}") from None


def file_of(scenario: Scenario, check: str) -> str:
    return f"{scenario.name}-{re.sub(r'[^A-Za-z0-9_.-]', '-', check)}.yaml"


@dataclass(frozen=True, slots=True)
class RegressionResult:
    failure: FoundFailure  # the scenario, with the expected verdict
    got: str  # the verdict now, in words
    same: bool  # whether it is the expected verdict
    broken: bool  # whether the run has no verdict
    differs: bool  # whether the same version of fleet made another log. A change of its code cannot be the reason
    wall_s: float  # duration of the run [s]
    failed: tuple[str, ...] = ()  # the checks that fail now
    digest: str = ""  # of its log
    version: str = ""  # of fleet, that made the digest
    accepted: bool = False  # whether this outcome has replaced the expected one


class Regression:
    """The scenarios of a folder, read and ready to run."""

    def __init__(self, folder: FailureFolder) -> None:
        """Read every scenario. Raises ScenarioError: one of them has mistakes, or a law that may not run; StudyError:
        the folder is damaged, or holds nothing."""
        self._folder, self.failures = folder, folder.failures()
        if not self.failures:
            raise StudyError(f"{folder.path} holds no failures: fleet search SCENARIO --keep {folder.path} fills it")
        self._scenarios = [folder.load(failure) for failure in self.failures]
        for scenario in self._scenarios:
            refuse(scenario, "a run of a study", stacks=True)
        self.modules = modules_of(self._scenarios, folder.path)

    @property
    def times(self) -> int:
        """How often each is run: on the wall clock several times."""
        return VOTES if self.modules.programs else 1

    def run(
        self, engine: Engine, on_progress: Callable[[int], None], modules: Modules, timeout_s: float = inf
    ) -> list[RegressionResult]:
        """Run them all; returns what came out, in the order of the folder."""
        rows: dict[int, list[Row]] = {number: [] for number in range(len(self.failures))}
        made = 0

        def tasks() -> Iterator[Task]:
            for number, (failure, scenario) in enumerate(zip(self.failures, self._scenarios, strict=True)):
                text = scenario.to_undrawn_yaml()
                key = run_key(f"{text}\nseed {failure.seed}")
                for _ in range(self.times):
                    yield Task(key, number, failure.seed, scenario.name, text, timeout_s, modules)

        def take(new: list[Row]) -> None:
            nonlocal made
            made += len(new)
            for row in new:
                rows[row.point].append(row)
            on_progress(made // self.times)

        engine.make(tasks(), take, lambda: on_progress(made // self.times))
        return [_compare(failure, rows[number]) for number, failure in enumerate(self.failures)]

    def accept(self, found: list[RegressionResult]) -> list[RegressionResult]:
        """Expect from now on what came out: the verdict, and the digest of the log.

        A run that fails is expected to fail the check that it failed before, or else the first one that it fails.

        Args:
            found: What `run` returned.

        Returns:
            The same, with what is expected now.

        Raises:
            StudyError: The folder cannot be written.
        """
        settled = []
        for one in found:
            failure = one.failure
            if not one.broken:
                failure.expected = "fail" if one.failed else "pass"
                if one.failed and failure.check not in one.failed:
                    failure.check = one.failed[0]
                failure.digest, failure.version = one.digest, one.version
                failure.paste = self._folder.paste(failure)
            settled.append(replace(one, same=not one.broken, differs=False, accepted=not (one.same or one.broken)))
        self._folder.update(self.failures)
        return settled


def _compare(failure: FoundFailure, rows: list[Row]) -> RegressionResult:
    row, fails, of = majority(rows, failure.check)
    found = _compared_one(failure, row)
    if len(rows) == 1 or found.broken:
        return found
    count = fails if failure.check in row.failed_checks else of - fails
    return replace(found, got=f"{found.got} in {count} of {of} runs", differs=False, digest="")


def _compared_one(failure: FoundFailure, row: Row) -> RegressionResult:
    wall_s = row.numbers.get("wall_s", 0.0)
    if not row.judged:
        return RegressionResult(failure, f"no result: {row.reason}", False, True, False, wall_s)
    failed = row.failed_checks
    fails = failure.check in failed
    same = fails if failure.expected == "fail" else not failed
    got = f"fails {', '.join(failed)}" if failed else "passes"
    differs = row.version == failure.version and row.digest != failure.digest
    return RegressionResult(failure, got, same, False, differs, wall_s, tuple(failed), row.digest or "", row.version)


def make_least(
    folder: FailureFolder,
    scenario: Scenario,
    engine: Engine,
    on_progress: Callable[[str, int], None],
    modules: Modules,
    most_runs: int,
) -> list[FoundFailure]:
    """Make the failures in a folder as small as possible, unless that is done already. `on_progress`: called now and
    then with the present step, in words, and the number of runs made. Returns the failures that were made smaller.
    Raises StudyError: a failure cannot be read or written."""
    done = []
    for failure in folder.of(scenario):
        if failure.least or failure.expected != "fail":
            continue
        first = folder.load(failure, imports=False)  # workers import its laws, as they did when it was found
        found = Shrinker(first, engine, on_progress, modules).shrink(failure.check, most_runs)
        least = FoundFailure(file=failure.file, check=failure.check, seed=found.scenario.seed, digest=found.digest,
                        found=found.found[1], from_seed=failure.from_seed, least=True,
                        version=version("uuv-fleet"))  # fmt: skip
        done.append(folder.add(least, found.scenario))
    return done
