"""The operator: scenarios, launch and supervision, the clock, the log and the command line."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

from fleet.cores import hidden_cores

if TYPE_CHECKING:
    from fleet.execution.stepped_run import Run as Run
    from fleet.execution.stepped_run import run as run
    from fleet.logs.open_log import Log as Log
    from fleet.logs.open_log import open_log as open_log
    from fleet.pictures.gallery import plot as plot
    from fleet.result.result import Result as Result
    from fleet.rl.parallel_env import parallel_env as parallel_env
    from fleet.study.study import Boundary as Boundary
    from fleet.study.study import Study as Study
    from fleet.study.study import boundary as boundary
    from fleet.study.study import open_study as open_study
    from fleet.study.study import sweep as sweep

_OFFERED = {
    "Result": "fleet.result.result",
    "run": "fleet.execution.stepped_run",
    "Run": "fleet.execution.stepped_run",
    "Log": "fleet.logs.open_log",
    "open_log": "fleet.logs.open_log",
    "Boundary": "fleet.study.study",
    "boundary": "fleet.study.study",
    "Study": "fleet.study.study",
    "open_study": "fleet.study.study",
    "parallel_env": "fleet.rl.parallel_env",
    "plot": "fleet.pictures.gallery",
    "sweep": "fleet.study.study",
}
__all__ = [
    "Boundary",
    "Log",
    "Result",
    "Run",
    "Study",
    "boundary",
    "open_log",
    "open_study",
    "parallel_env",
    "plot",
    "run",
    "sweep",
]


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


@cache
def _warn_of_hidden_cores() -> None:
    if words := hidden_cores():
        warn(words, RuntimeWarning, stacklevel=3)


def __getattr__(name: str) -> Any:
    # Every command imports this package; numpy and protobuf come with the first use.
    if name in _OFFERED:
        _warn_of_hidden_cores()
        return getattr(import_module(_OFFERED[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
