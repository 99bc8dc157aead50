"""Worker processes of this machine that call a function for each of many items.

Each worker is a pool of one process, so that of a worker that dies it is known which item it had, and the others go on.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor
from concurrent.futures import wait as until
from concurrent.futures.process import BrokenProcessPool
from types import TracebackType
from typing import TypeVar

from fleet.processes.interrupts import out_of_reach
from fleet.processes.parent_death import die_with_parent
from fleet.processes.safe_path import children_ignore_the_folder

I = TypeVar("I")  # noqa: E741
R = TypeVar("R")

WorkerDied = BrokenProcessPool  # the exception of an item whose worker died each time
TIMES = 3  # that an item is given to a worker, and a run of a study to one of Dask


class Workers:
    """Some worker processes, which end with the context; they leave Ctrl-C to us and never outlive us."""

    def __init__(self, count: int, begin: Callable[[], None] | None = None) -> None:
        """Prepare them; a process starts when there is an item for it.

        Args:
            count: how many.
            begin: called first in each process. What only a process that is starting can take, such as an array in
                shared memory, belongs into it.
        """
        self.count = count
        self._begin = begin
        self._context = multiprocessing.get_context("spawn")
        self._pools: dict[int, ProcessPoolExecutor] = {}

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        processes = [process for pool in self._pools.values() for process in (pool._processes or {}).values()]
        for pool in self._pools.values():
            pool.shutdown(wait=kind is None, cancel_futures=True)
        if kind is not None:
            for process in processes:
                process.terminate()

    def each(
        self, function: Callable[[I], R], items: Iterable[I], wait: Callable[[], None] = lambda: None
    ) -> Iterator[tuple[I, Future[R]]]:
        """Call the function for every item, in the order of the items, as workers become free.

        Args:
            wait: is called several times a second.

        Yields:
            Each item with the future of its result, as they end. The exception of an item under which a worker died
            `TIMES` times is a WorkerDied.
        """
        new = ((item, 1) for item in items)
        again: deque[tuple[I, int]] = deque()
        idle = list(range(self.count))
        under_way: dict[Future[R], tuple[int, I, int]] = {}
        while True:
            while idle and (job := again.popleft() if again else next(new, None)) is not None:
                worker = idle.pop()
                under_way[self._submit(worker, function, job[0])] = (worker, *job)
            if not under_way:
                return
            for future in until(under_way, timeout=0.2, return_when=FIRST_COMPLETED).done:
                worker, item, times = under_way.pop(future)
                idle.append(worker)
                if times < TIMES and isinstance(future.exception(), WorkerDied):
                    again.append((item, times + 1))
                else:
                    yield item, future
            wait()

    def _submit(self, worker: int, function: Callable[[I], R], item: I) -> Future[R]:
        with out_of_reach():
            if worker in self._pools:
                try:
                    return self._pools[worker].submit(function, item)
                except BrokenProcessPool:
                    pass  # it died; another one in its place
            children_ignore_the_folder()
            pool = ProcessPoolExecutor(1, self._context, _start, (os.getpid(), self._begin))
            self._pools[worker] = pool
            return pool.submit(function, item)


def _start(parent: int, begin: Callable[[], None] | None) -> None:
    die_with_parent(parent)
    if begin is not None:
        begin()
