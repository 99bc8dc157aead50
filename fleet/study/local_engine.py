"""Processes of this program that make runs: they are there at once, and need no Dask."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from fleet.processes.processors import processors
from fleet.processes.workers import Workers
from fleet.study.engine import Row, lost_row, make_batch, need_extra, reason_of, remote_engine
from fleet.study.modules import Modules
from fleet.study.one_run import Task


class AnyEngine(Protocol):
    """What makes runs."""

    def carry(self, modules: Modules) -> Modules:
        """See `Engine.carry`."""

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """See `Engine.make`."""


@dataclass(frozen=True, slots=True)
class LocalEngine:
    """Workers of this machine, without Dask."""

    workers: Workers

    def carry(self, modules: Modules) -> Modules:
        """These are processes of this machine, which import them where they lie."""
        return modules

    def make(self, tasks: Iterator[Task], take: Callable[[list[Row]], None], wait: Callable[[], None]) -> None:
        """See `Engine.make`."""
        for (task,), future in self.workers.each(make_batch, ([task] for task in tasks), wait):
            error = future.exception()
            take(future.result() if error is None else [lost_row(task, reason_of(error))])


@contextmanager
def small_engine(workers: int | None = None, scheduler: str | None = None) -> Iterator[AnyEngine]:
    """An engine for some hundred runs, for which starting Dask here would not pay.

    Args:
        workers: how many; None: one per core.
        scheduler: of a Dask cluster that is there, to be used instead.

    Raises:
        StudyError: the cluster cannot be used.
    """
    if scheduler is not None:
        need_extra()
        with remote_engine(scheduler) as engine:
            yield engine
    else:
        with Workers(workers or processors()) as pool:
            yield LocalEngine(pool)
