"""Engines of studies without workers: the runs are made here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from fleet.study.engine import make_batch
from fleet.study.modules import Modules
from fleet.study.one_run import Task

Rows = list[dict[str, Any]]


class Here:
    """Makes runs in this process, in their order or in batches from the last to the first; stops after some."""

    workers, dashboard, here = 1, "", True

    def __init__(self, *, backwards: bool = False, most: int | None = None) -> None:
        self.backwards, self.most = backwards, most
        self.tasks: list[Task] = []  # that were made

    def carry(self, modules: Modules) -> Modules:
        """As `Engine.carry`."""
        return modules

    def make(self, tasks: Iterator[Task], take: Callable[[Rows], None], wait: Callable[[], None]) -> None:
        """As `Engine.make`. Raises KeyboardInterrupt after `most` runs."""
        chosen = list(tasks)[:: -1 if self.backwards else 1]
        for task in islice(chosen, self.most):
            self.tasks.append(task)
            take(make_batch([task]))
            wait()
        if self.most is not None and self.most < len(chosen):
            raise KeyboardInterrupt
