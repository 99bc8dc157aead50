"""Processes of this machine make the runs of a study; they are there at once, and need no library."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

from fleet.processes.limits import processors
from fleet.processes.workers import WorkerDied, WorkerLate, Workers
from fleet.study.dask_engine import dask_engine
from fleet.study.engine import LOST, Engine, Row, lost_row
from fleet.study.modules import Modules
from fleet.study.one_run import GRACE_S, Task, late, make_run


@dataclass(frozen=True, slots=True)
class LocalEngine:
    """Workers of this machine."""

    workers: Workers
    here: bool = True

    def carry(self, modules: Modules) -> Modules:
        """These are processes of this machine, which import them where they lie."""
        return modules

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """See `Engine.make`. Where a law hangs, the worker is killed soon after the time that its run may take."""
        for task, future in self.workers.each(make_run, tasks, wait, lambda task: task.timeout_s + GRACE_S):
            error = future.exception()
            take([future.result() if error is None else lost_row(task, _reason(task, error))])


@contextmanager
def local_engine(workers: int) -> Iterator[LocalEngine]:
    """So many workers on this machine, which end with the context. Raises RunBroken: so many cannot be."""
    with Workers(workers) as pool:
        yield LocalEngine(pool)


def engine_of(workers: int | None = None, scheduler: Any = None) -> AbstractContextManager[Engine]:
    """The engine that was asked for.

    Args:
        workers: of this machine; None: one per core.
        scheduler: of an existing Dask cluster, to be used instead: its address, or a cluster object.

    Raises:
        RunBroken: there cannot be so many workers here.
        StudyError: the cluster cannot be used.
    """
    return local_engine(workers or processors()) if scheduler is None else dask_engine(scheduler)


def _reason(task: Task, error: BaseException) -> str:
    """Why a run gave no row."""
    match error:
        case WorkerLate():
            return str(late(task))
        case WorkerDied():
            return LOST
        case _:
            return f"{type(error).__name__}: {error!s:.500}"
