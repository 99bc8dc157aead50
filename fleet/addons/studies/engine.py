"""The engine of a study's runs: workers of this machine, or an existing Dask cluster."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import Any

from fleet.addons.studies.dask_engine import dask_engine
from fleet.addons.studies.engine_interface import LOST, Engine, lost_row
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.modules import Modules
from fleet.addons.studies.one_run import GRACE_S, Task, late, make_run
from fleet.addons.studies.row import Row
from fleet.addons.studies.stack_runs import StackRuns
from fleet.processes.limits import processors
from fleet.processes.workers import WorkerDied, WorkerLate, Workers


@dataclass(frozen=True, slots=True)
class LocalEngine:
    """Processes of this machine: they are there at once, and need no library."""

    workers: Workers
    stacks: StackRuns
    here: bool = True

    def carry(self, modules: Modules) -> Modules:
        """These are processes of this machine, which import them where they lie."""
        return modules

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """See `Engine.make`. Where a law hangs, the worker is killed soon after the time that its run may take."""
        if (first := next(tasks, None)) is None:
            return
        tasks = chain([first], tasks)
        if first.modules.programs:
            self.stacks.make(tasks, take, wait)
            return
        for task, future in self.workers.each(make_run, tasks, wait, lambda task: task.timeout_s + GRACE_S):
            error = future.exception()
            take([future.result() if error is None else lost_row(task, _reason(task, error))])


@contextmanager
def local_engine(workers: int | None, tell: Callable[[str], None] = warnings.warn) -> Iterator[LocalEngine]:
    """A pool of workers on this machine, closed on exit. None: one per core, and of runs of programs as many as the
    machine can take. `tell`: gets sentences on how these go. Raises RunBroken if they cannot be started."""
    with Workers(workers or processors()) as pool:
        yield LocalEngine(pool, StackRuns(workers, tell))


def engine_of(
    modules: Modules,
    workers: int | None = None,
    scheduler: Any = None,
    tell: Callable[[str], None] = warnings.warn,
) -> AbstractContextManager[Engine]:
    """The engine that was asked for.

    Args:
        modules: what the runs need.
        workers: of this machine; None: one per core.
        scheduler: of an existing Dask cluster, to be used instead: its address, or a cluster object.
        tell: gets sentences on how the runs go.

    Raises:
        RunBroken: there cannot be so many workers here.
        StudyError: the cluster cannot be used, or cannot make such runs.
    """
    if modules.programs and scheduler is not None:  # before anybody looks for it
        raise StudyError("programs of a stack run on this machine alone: leave --scheduler out")
    return local_engine(workers, tell) if scheduler is None else dask_engine(scheduler)


def _reason(task: Task, error: BaseException) -> str:
    match error:
        case WorkerLate():
            return str(late(task))
        case WorkerDied():
            return LOST
        case _:
            return f"{type(error).__name__}: {error!s:.500}"
