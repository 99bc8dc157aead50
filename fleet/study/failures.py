"""A folder of failures: one small scenario per kind of failure, with what is expected of it.

```text
DIR/NAME-CHECK.yaml    a scenario with explicit faults; `fleet run` runs it
DIR/failures.json      of each: seed, check, expected verdict, digest of its log, and a line to paste
DIR/NAME.search.json   how far the search of the scenario NAME is, so that it can go on
DIR/NAME.guide.msgpack the same of a search with a guide (`guided_memory`)
```

A kind of failure is the check that fails. `fleet search --keep DIR` fills the folder, `fleet regress DIR` runs it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct

from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.trust import Policy
from fleet.study.errors import StudyError
from netem.private_file import read_file, write_whole

INDEX = "failures.json"
FORMAT = 1  # of both JSON files
_MOST_BYTES = 4_000_000
_MOST_FAILURES = 10_000
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
    failures: Annotated[list[FoundFailure], Meta(max_length=_MOST_FAILURES)]


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
        """Write a scenario and what is expected of it, in place of what was there of this name.

        Raises:
            StudyError: it cannot be written.
        """
        path = self.path / failure.file
        failure.paste = f"fleet run {path} --seed {failure.seed}  # fails {failure.check}, sha256 {failure.digest[:16]}"
        self._write(path, scenario.to_yaml().encode())
        self.update([*(one for one in self.failures() if one.file != failure.file), failure])
        return failure

    def load(self, failure: FoundFailure, policy: Policy) -> Scenario:
        """One of its scenarios.

        Raises:
            ScenarioError: with every mistake that was found.
            StudyError: it cannot be read.
        """
        path = self.path / failure.file
        try:
            text = read_file(path, _MOST_BYTES).decode("utf-8")
        except OSError as error:
            raise StudyError(f"{path} cannot be read: {error.strerror}") from None
        except UnicodeDecodeError:
            raise StudyError(f"{path} is not UTF-8 text") from None
        return parse_scenario(text, str(path), [f"seed={failure.seed}"], self.path, policy)

    def update(self, failures: list[FoundFailure]) -> None:
        """Write what is expected. Raises StudyError."""
        index = _Index(FORMAT, sorted(failures, key=lambda one: one.file))
        self._write(self.path / INDEX, msgspec.json.format(msgspec.json.encode(index), indent=1) + b"\n")

    def tried(self, scenario: Scenario, key: str) -> SearchProgress:
        """How far the search of a scenario is.

        Args:
            key: of the scenario without its seed.

        Raises:
            StudyError: it is damaged, or was made of another scenario of this name.
        """
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
            found = msgspec.json.decode(read_file(path, _MOST_BYTES), type=kind)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StudyError(f"{path} cannot be read: {error.strerror}") from None
        except msgspec.DecodeError as error:
            raise StudyError(f"{path} is damaged: {error!s:.200}") from None
        if (version := getattr(found, "format", FORMAT)) != FORMAT:
            raise StudyError(f"{path} has format {version}, expected {FORMAT}: a later fleet wrote it")
        return found

    def _write(self, path: Path, data: bytes) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            write_whole(path, data, 0o644)
        except OSError as error:
            raise StudyError(f"{path} cannot be written: {error.strerror}") from None


def file_of(scenario: Scenario, check: str) -> str:
    """The name of the file of a kind of failure."""
    return f"{scenario.name}-{re.sub(r'[^A-Za-z0-9_.-]', '-', check)}.yaml"
