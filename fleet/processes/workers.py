"""Worker processes of this machine that call a function for each of many items.

Each worker has a pipe of its own and one item at a time. So it is known which item a worker had when it died, an item
that takes too long ends with its worker, and the others go on. There is no thread, no queue that workers share, and
nothing on disk. Workers do not import the main module of a script.

A worker that dies loses its own call only; with `concurrent.futures` 21 calls were lost. A worker that is late is
killed, which neither `concurrent.futures` nor loky does. Only pebble would do as well. A call costs 0.3 ms of CPU time,
in pebble 0.4 ms.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from math import inf
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as until
from types import TracebackType
from typing import Any, TypeVar

from fleet.errors import FleetError, RunBroken
from fleet.processes.child_start import children_ignore_the_folder, die_with_parent, without_main
from fleet.processes.interrupts import out_of_reach
from fleet.processes.limits import allow_workers

I = TypeVar("I")  # noqa: E741
R = TypeVar("R")

TIMES = 3  # how often an item is given to a worker, at most
_READY, _BEGUN, _DONE, _FAILED = range(4)
_WAIT_S = 0.2
_GRACE_S = 2.0  # time for an idle worker to end
_BEGIN_S = 300.0  # time for a process to start, to import and to begin with its item: usually 1 s


class WorkerDied(FleetError):
    """The exception of an item whose worker died each time."""


class WorkerLate(FleetError):
    """The exception of an item that took too long; its worker was killed."""


class Workers:
    """Some worker processes, which end with the context; they leave Ctrl-C to us and never outlive us."""

    def __init__(self, count: int, begin: Callable[[], None] | None = None) -> None:
        """Prepare `count` workers; a process starts when there is an item for it, and calls `begin` first. Raises
        RunBroken if too few files may be open for them.
        """
        self.count = count
        self._begin = begin
        self._running: list[_Worker | None] = [None] * count
        allow_workers(count)

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        workers = [worker for worker in self._running if worker is not None]
        for worker in workers:
            worker.connection.close()  # an idle worker takes this as the end
            if kind is not None:
                worker.process.kill()
        for worker in workers:
            worker.end(_GRACE_S)

    @property
    def pids(self) -> list[int]:
        return [worker.process.pid for worker in self._running if worker is not None and worker.process.pid is not None]

    def each(
        self,
        function: Callable[[I], R],
        items: Iterable[I],
        wait: Callable[[], None] = lambda: None,
        limit_s: Callable[[I], float] = lambda _: inf,
    ) -> Iterator[tuple[I, Future[R]]]:
        """Call the function for every item, in the order of the items, as workers become free; `wait` is called several
        times a second. Yields each item with the future of its result, as they end. If a worker died `TIMES` times
        under an item, its exception is a WorkerDied; if the item took longer than `limit_s` of it, a WorkerLate. Raises
        RunBroken if no process can be started, or each ends before it begins with its item, or one hangs there.
        """
        new = ((item, 1) for item in items)
        again: deque[tuple[I, int]] = deque()
        under_way: dict[int, tuple[I, int]] = {}  # by place: the item that its worker has, and at which try
        lost = 0  # workers in a row that died before they began
        try:
            while True:
                for place in range(self.count):
                    if place in under_way:
                        continue
                    if (job := again.popleft() if again else next(new, None)) is None:
                        break
                    under_way[place] = job
                    self._give(place, pickle.dumps((function, job[0])), limit_s(job[0]))
                if not under_way:
                    return
                for place, worker in self._heard(under_way):
                    if (ended := worker.hear()) is None:
                        continue
                    begun, outcome = ended
                    item, times = under_way.pop(place)
                    if worker.dead:
                        self._running[place] = None
                    error = outcome.exception()
                    if isinstance(error, WorkerLate) and not begun:
                        raise RunBroken(
                            f"a worker process did not begin with its work within {_BEGIN_S:g} s, and was killed: does "
                            "a module hang while it is imported, or a file system that it reads?"
                        )
                    died = isinstance(error, WorkerDied)
                    lost = lost + 1 if died and not begun else 0
                    if lost > TIMES * self.count:
                        raise RunBroken(f"{lost} worker processes in a row ended before they began ({worker.ended})")
                    if died and (times < TIMES or not begun):  # a worker that had not begun says nothing of the item
                        again.append((item, times + begun))
                    else:
                        yield item, outcome
                wait()
        finally:  # the caller wants no more: what is under way ends, so that the next call finds free workers
            for place in under_way:
                self._stop(place)

    def _give(self, place: int, job: bytes, limit_s: float) -> None:
        worker = self._running[place]
        if worker is not None and not worker.process.is_alive():  # somebody killed it while it had nothing to do
            self._stop(place)
            worker = None
        if worker is None:
            try:
                worker = self._running[place] = _Worker(self._begin)
            except OSError as error:
                raise RunBroken(
                    f"cannot start a worker process: {error.strerror}; are there too many processes (ulimit -u), or "
                    "is there too little memory? --workers takes fewer"
                ) from None
        worker.give(job, limit_s)

    def _heard(self, under_way: Iterable[int]) -> list[tuple[int, _Worker]]:
        workers = {place: worker for place in under_way if (worker := self._running[place]) is not None}
        left = min(worker.deadline for worker in workers.values()) - time.monotonic()
        sources = [source for worker in workers.values() for source in (worker.connection, worker.process.sentinel)]
        ready = set(until(sources, timeout=max(0.0, min(_WAIT_S, left))))
        now = time.monotonic()
        return [
            (place, worker)
            for place, worker in workers.items()
            if worker.connection in ready or worker.process.sentinel in ready or now > worker.deadline
        ]

    def _stop(self, place: int) -> None:
        if (worker := self._running[place]) is not None:
            worker.end(0.0)
            self._running[place] = None


class _Worker:
    def __init__(self, begin: Callable[[], None] | None) -> None:
        context = multiprocessing.get_context("spawn")
        children_ignore_the_folder()
        self.connection, theirs = context.Pipe()
        self.deadline = inf
        self.dead = False
        self._job = b""
        self._limit_s, self._ready, self._begun = inf, False, False
        self.process = context.Process(target=_work, args=(theirs, os.getpid(), begin), daemon=False)
        try:
            with without_main(), out_of_reach():
                self.process.start()
        except OSError:
            self.connection.close()
            raise
        finally:
            theirs.close()

    def give(self, job: bytes, limit_s: float) -> None:
        self._job, self._limit_s, self._begun = job, limit_s, False
        self.deadline = time.monotonic() + _BEGIN_S
        if self._ready:
            self._send()

    def hear(self) -> tuple[bool, Future[Any]] | None:
        """Take what it says: whether it had begun with its job, and what came of it; None: it goes on."""
        try:
            if self.connection.poll():
                what, *value = _unpack(self.connection.recv_bytes())
                if what == _READY:
                    self._ready = True
                    self._send()
                elif what == _BEGUN:
                    self._begun, self.deadline = True, time.monotonic() + self._limit_s
                elif what == _DONE:
                    return self._ended(value[0])
                else:
                    return self._ended(value[0], failed=True)
                return None
            if self.process.is_alive():
                if time.monotonic() <= self.deadline:
                    return None
                self.end(0.0)
                return self._ended(WorkerLate(), failed=True)
        except (EOFError, OSError):  # the worker died while it wrote
            pass
        self.end(0.0)
        return self._ended(WorkerDied(self.ended), failed=True)

    @property
    def ended(self) -> str:
        code = self.process.exitcode
        return f"signal {-code}" if code is not None and code < 0 else f"exit status {code}"

    def end(self, grace_s: float) -> None:
        self.dead = True
        self.connection.close()
        if grace_s:
            self.process.join(grace_s)
        self.process.kill()
        self.process.join()

    def _send(self) -> None:
        self.deadline = time.monotonic() + _BEGIN_S
        with suppress(OSError):  # the worker died, as its sentinel says
            self.connection.send_bytes(self._job)
        self._job = b""

    def _ended(self, value: Any, *, failed: bool = False) -> tuple[bool, Future[Any]]:
        begun, self._begun, self.deadline = self._begun, False, inf
        future: Future[Any] = Future()
        if failed:
            future.set_exception(value)
        else:
            future.set_result(value)
        return begun, future


def _work(connection: Connection, parent: int, begin: Callable[[], None] | None) -> None:
    die_with_parent(parent)
    if begin is not None:
        begin()
    connection.send_bytes(pickle.dumps((_READY,)))
    while True:
        try:
            job = connection.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            function, item = pickle.loads(job)
            connection.send_bytes(pickle.dumps((_BEGUN,)))
            answer = pickle.dumps((_DONE, function(item)))
        except BaseException as error:  # SystemExit of a law, too: the parent says what becomes of it
            answer = _pack_error(error)
        try:
            connection.send_bytes(answer)
        except OSError:
            return


def _unpack(data: bytes) -> Any:
    """A worker's answer. If only the worker knows its class, the result is an exception that says so."""
    try:
        return pickle.loads(data)
    except Exception as error:  # as the import of somebody's module raises it
        return _FAILED, RuntimeError(f"what the worker answered is not known here: {error!s:.500}")


def _pack_error(error: BaseException) -> bytes:
    """An exception for the parent. If it cannot travel, its text does."""
    try:
        data = pickle.dumps((_FAILED, error))
        pickle.loads(data)
    except Exception:
        return pickle.dumps((_FAILED, RuntimeError(f"{type(error).__name__}: {error!s:.500}")))
    return data
