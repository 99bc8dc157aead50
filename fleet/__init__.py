"""The operator: scenarios, launch and supervision, the clock, the log and the command line."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

from fleet.cores import hidden_cores

if TYPE_CHECKING:  # for type checkers alone: at run time the add-ons themselves say what they offer here
    from fleet.addons.learning.parallel_env import parallel_env as parallel_env
    from fleet.addons.pictures.gallery import plot as plot
    from fleet.addons.studies.study import Boundary as Boundary
    from fleet.addons.studies.study import Study as Study
    from fleet.addons.studies.study import boundary as boundary
    from fleet.addons.studies.study import open_study as open_study
    from fleet.addons.studies.study import sweep as sweep
    from fleet.execution.stepped_run import Run as Run
    from fleet.execution.whole_run import run as run
    from fleet.logs.open_log import Log as Log
    from fleet.logs.open_log import open_log as open_log
    from fleet.result.result import Result as Result

_OFFERED = {
    "Result": "fleet.result.result",
    "run": "fleet.execution.whole_run",
    "Run": "fleet.execution.stepped_run",
    "Log": "fleet.logs.open_log",
    "open_log": "fleet.logs.open_log",
}
_DEPRECATED = {"SteppedRun": "Run", "stepping": "Run"}  # names of version 1.0, and what they are now


@cache
def _warn_of_hidden_cores() -> None:
    if words := hidden_cores():
        warn(words, RuntimeWarning, stacklevel=3)


@cache
def _every_name() -> dict[str, str]:
    from fleet.addon import installed_addons  # not above: every command imports this package, and few need add-ons

    of_addons = (addon.names for addon in installed_addons().addons.values())
    return {**{name: module for names in of_addons for name, module in names.items()}, **_OFFERED}


def __dir__() -> list[str]:
    return sorted({*_every_name(), *(name for name in globals() if name.startswith("__"))})


def __getattr__(name: str) -> Any:
    # Every command imports this package; numpy and protobuf come with the first use.
    if name == "__all__":
        return sorted(_every_name())
    if (now := _DEPRECATED.get(name)) is not None:
        warn(f"fleet.{name} is deprecated, use fleet.{now}", DeprecationWarning, stacklevel=2)
        name = now
    module = _OFFERED.get(name) or ("" if name.startswith("_") else _every_name().get(name))
    if not module:
        from fleet.addon import installed_addons

        why = (
            ""
            if name.startswith("_")
            else "; ".join(f"{k} is left out: {v}" for k, v in installed_addons().left_out.items())
        )
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{f'; {why}' if why else ''}")
    _warn_of_hidden_cores()
    return getattr(import_module(module), name)
