"""Studies by name: those that ship with the package, and files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from fleet.quantities import time_ns
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.text.yaml_reader import Source
from fleet.scenario.trust import TYPED, Origin, origin
from fleet.study.errors import StudyError
from fleet.study.spec import StudySpec
from fleet.study.study_file import is_study, parse_study
from netem.parsing import nearest
from netem.whole_file import read_file

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

_MAX_BYTES = 4_000_000  # as many as the characters that yaml_reader takes can have


class NamedStudy(NamedTuple):
    """A study that somebody wrote down, and where it comes from."""

    spec: StudySpec
    origin: Origin = TYPED


class Listed(NamedTuple):
    """One row of the list of studies that ship."""

    name: str
    title: str
    scenario: str
    runs: int
    core_s: float  # what all runs take one core, roughly [s]


def shipped_studies() -> list[str]:
    """The names of the studies that come with the package."""
    return sorted(entry.name.removesuffix(".yaml") for entry in _folder().iterdir() if entry.name.endswith(".yaml"))


def list_studies() -> list[Listed]:
    """Every study that ships, by name."""
    return [_listed(name) for name in shipped_studies()]


def study_named(name: str) -> NamedStudy | None:
    """The study of a shipped name or of a file; None: it may be the name of a scenario.

    Raises:
        ScenarioError: with every mistake in the file.
        StudyError: the name is nearly that of a study.
    """
    if name in shipped_studies():
        return NamedStudy(_shipped(name))
    path = Path(name)
    if not path.is_file():
        close = nearest(name, shipped_studies())
        if close and name not in shipped_scenarios() and not path.suffix:
            raise StudyError(f"there is no study or scenario {name}; {close}")
        return None
    try:
        source = Source(name, read_file(path, _MAX_BYTES).decode("utf-8-sig"))
    except (OSError, ValueError):  # who reads it as a scenario says what is wrong
        return None
    return NamedStudy(parse_study(source, path.parent), origin(path)) if is_study(source) else None


def _shipped(name: str) -> StudySpec:
    return parse_study(Source(f"{name}.yaml", (_folder() / f"{name}.yaml").read_text("utf-8")))


def _listed(name: str) -> Listed:
    spec = _shipped(name)
    runs = len(spec.plan())
    return Listed(name, spec.title, spec.scenario, runs, runs * time_ns(spec.run_takes) / 1e9)


def _folder() -> Traversable:
    return resources.files("fleet.study.shipped")
