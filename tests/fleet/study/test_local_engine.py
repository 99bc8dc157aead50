"""Runs of a study in processes of this program."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from math import inf
from typing import Any

from small_scenario import small

from fleet.processes.workers import WorkerDied
from fleet.study.engine import LOST
from fleet.study.local_engine import LocalEngine
from fleet.study.one_run import FAILED, Task

WITHOUT = """
import sys
from math import inf
for name in ("dask", "distributed", "pyarrow", "scipy", "pandas", "xarray", "cryptography"):
    sys.modules[name] = None  # as if it were not installed
from fleet.study.local_engine import small_engine
from fleet.study.one_run import Task
from fleet.study.search import search
from fleet.study.shrink import Shrinker
if __name__ == "__main__":
    tasks = [Task(f"key-{seed}", 0, seed, "small", sys.argv[1], inf) for seed in (1, 2)]
    with small_engine(1) as engine:
        engine.make(iter(tasks), lambda rows: print(*[(row["key"], row["status"]) for row in rows]), lambda: None)
"""


def test_it_needs_no_library_of_the_extra() -> None:
    text = small("duration=100 ms", "checks={}").to_yaml()
    done = subprocess.run([sys.executable, "-c", WITHOUT, text], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == ["('key-1', 'pass')", "('key-2', 'pass')"], done.stderr


class Dying:
    """Workers that die under every item."""

    def each(self, _: Any, items: Iterator[Any], __: Any) -> Iterator[tuple[Any, Future[Any]]]:
        for item in items:
            future: Future[Any] = Future()
            future.set_exception(WorkerDied("gone"))
            yield item, future


def test_a_run_whose_worker_dies_is_a_row_that_says_so() -> None:
    rows: list[dict[str, Any]] = []
    engine = LocalEngine(Dying())  # type: ignore[arg-type]
    engine.make(iter([Task("key", 4, 7, "small", "", inf)]), rows.extend, lambda: None)
    (row,) = rows
    assert (row["key"], row["point"], row["seed"], row["status"], row["reason"]) == ("key", 4, 7, FAILED, LOST)
