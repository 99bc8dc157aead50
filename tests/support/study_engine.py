"""Engines of studies without workers: the runs are made here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from small_scenario import SMALL

from fleet.addons.studies.modules import Modules
from fleet.addons.studies.one_run import Task, make_run
from fleet.addons.studies.row import Row

Rows = list[Row]


class Here:
    """Makes runs in this process, in their order or in batches from the last to the first; stops after some."""

    here = True

    def __init__(self, *, backwards: bool = False, most: int | None = None) -> None:
        self.backwards, self.most = backwards, most
        self.tasks: list[Task] = []  # that were made

    def carry(self, modules: Modules) -> Modules:
        """As `Engine.carry`."""
        return modules

    def make(self, tasks: Iterator[Task], take: Callable[[Rows], None], wait: Callable[[], None]) -> None:
        """As `Engine.make`. Raises KeyboardInterrupt after `most` runs in all."""
        chosen = list(tasks)[:: -1 if self.backwards else 1]
        left = len(chosen) if self.most is None else self.most - len(self.tasks)
        for task in islice(chosen, left):
            self.tasks.append(task)
            take(self.rows(task))
            wait()
        if left < len(chosen):
            raise KeyboardInterrupt

    def rows(self, task: Task) -> Rows:
        """The rows of a run."""
        return [make_run(task)]


class Drawn(Here):
    """Makes up whether a run passes, in place of making it."""

    def __init__(self, passes: Callable[[str, int], bool | None], **how: Any) -> None:
        """Take what a run of a scenario and a seed comes to; None: it has no result."""
        super().__init__(**how)
        self._passes = passes

    def rows(self, task: Task) -> Rows:
        passed = self._passes(task.text, task.seed)
        status = "failed" if passed is None else "pass" if passed else "check_failed"
        return [Row(key=task.key, point=task.point, seed=task.seed, status=status, passed=passed)]


def made_here(
    folder: Path, monkeypatch: pytest.MonkeyPatch, text: str = SMALL, engine: Callable[[], Here] = Here
) -> list[Here]:
    """Go to a folder with `small.yaml`, and make the runs of studies in this process: the engines that were used."""
    used: list[Here] = []

    def engine_of(*_: Any, **__: Any) -> Any:
        used.append(engine())
        return nullcontext(used[-1])

    for module in ("engine", "study"):
        monkeypatch.setattr(f"fleet.addons.studies.{module}.engine_of", engine_of)
    monkeypatch.chdir(folder)
    Path("small.yaml").write_text(text, "utf-8")
    return used
