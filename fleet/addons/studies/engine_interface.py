"""What makes the runs of a study, whatever its workers are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import version
from importlib.util import find_spec
from typing import Protocol

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import Modules
from fleet.addons.studies.one_run import Task
from fleet.addons.studies.row import FAILED, Row
from fleet.processes.workers import TIMES

NEEDED = ("scipy", "pandas", "xarray")
LOST = f"the worker that made it died {TIMES} times; is there enough memory?"


class Engine(Protocol):
    """What makes runs."""

    @property
    def here(self) -> bool:
        """Whether the workers are processes of this machine, of this user."""

    def carry(self, modules: Modules) -> Modules:
        """The modules of laws as runs on these workers need them. Raises StudyError: a worker cannot import them."""

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """Make every run, also if workers die meanwhile. `tasks`: the runs. A free worker takes the next one, so memory
        does not grow with their number. `take`: called with the rows of results as runs end. Raises RunBroken: no
        worker starts; StudyError: the workers are gone."""


def require_extra() -> None:
    """Raises StudyError: the libraries of the extra `study` are not installed."""
    require(NEEDED, "studies need", "study")


def require(libraries: Iterable[str], who: str, extra: str) -> None:
    """Raises StudyError: libraries of an extra are not installed."""
    missing = [name for name in libraries if find_spec(name) is None]
    if missing:
        raise StudyError(f"{who} {', '.join(missing)}: pip install 'uuv-fleet[{extra}]'")


def lost_row(task: Task, reason: str) -> Row:
    return Row(key=task.key, point=task.point, seed=task.seed, status=FAILED, reason=reason,
               version=version("uuv-fleet"))  # fmt: skip
