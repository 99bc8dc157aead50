"""A thread that hands one robot what is due for it: a program that is slow or stopped keeps no other robot waiting."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from threading import Thread
from time import monotonic_ns
from typing import Any, NamedTuple

from netem.errors import BusError
from netem.limits import ROBOT_WAITING


class HandOver(NamedTuple):
    """What became of a message that an outlet took."""

    message: Any  # the message as it was offered
    at_ns: int  # when it was handed over
    late_ns: int  # how long the host was late with it, beside its wait for the robot
    kept_ns: int  # how long the robot let it wait
    delivered: bool
    problem: str  # why the message was not delivered, if that is known


class _Job(NamedTuple):
    message: Any
    due_ns: int
    size: int
    hand: Callable[[], None]


class Outlet:
    """The queue of one robot, and its thread. All methods but `lost_link` belong to one other thread."""

    def __init__(self) -> None:
        self._jobs: SimpleQueue[_Job | Callable[[], None] | None] = SimpleQueue()
        self._offered, self._offered_bytes = 0, 0  # written by the thread that offers
        self._worked, self._worked_bytes = 0, 0  # written by the thread that hands over
        self._outcomes: deque[HandOver] = deque()
        self._problems: deque[str] = deque()
        self._free_ns = self._lost_ns = 0
        self.thread = Thread(target=self._serve, daemon=True)
        self.thread.start()

    def offer(self, message: Any, due_ns: int, size: int, hand: Callable[[], None]) -> bool:
        """Let the thread call `hand`, behind all that it has. False: too much is waiting, and this is not taken."""
        waiting, size_waiting = self._offered - self._worked, self._offered_bytes - self._worked_bytes
        if waiting and (waiting >= ROBOT_WAITING.items or size_waiting + size > ROBOT_WAITING.bytes):
            return False
        self._offered += 1
        self._offered_bytes += size
        self._jobs.put(_Job(message, due_ns, size, hand))
        return True

    def do(self, job: Callable[[], None]) -> None:
        """Let the thread do something that is no message, behind all that it has."""
        self._jobs.put(job)

    def outcomes(self) -> list[HandOver]:
        """What has become of messages since the last call."""
        return [self._outcomes.popleft() for _ in range(len(self._outcomes))]

    def problems(self) -> list[str]:
        """Why jobs that are no messages were not done to their end, since the last call."""
        return [self._problems.popleft() for _ in range(len(self._problems))]

    def lost_link(self) -> None:
        """A program has gone: what is being handed over just now may not reach it."""
        self._lost_ns = monotonic_ns()

    def close(self) -> None:
        """Let the thread end when it has done all."""
        self._jobs.put(None)

    def _hand(self, job: _Job) -> None:
        begin_ns = monotonic_ns()
        problem = _problem(job.hand)
        end_ns = monotonic_ns()
        late_ns = begin_ns - max(job.due_ns, self._free_ns)
        kept_ns = end_ns - job.due_ns - late_ns
        delivered = not problem and self._lost_ns < begin_ns
        self._outcomes.append(HandOver(job.message, end_ns, max(0, late_ns), max(0, kept_ns), delivered, problem))
        self._free_ns = end_ns
        self._worked += 1
        self._worked_bytes += job.size

    def _serve(self) -> None:
        while (job := self._jobs.get()) is not None:
            if isinstance(job, _Job):
                self._hand(job)
            elif problem := _problem(job):
                self._problems.append(problem)


def _problem(job: Callable[[], None]) -> str:
    """Do a job; returns why it failed, or an empty text. Nothing that it raises ends the thread."""
    try:
        job()
    except BusError as error:
        return str(error)
    except BaseException as error:  # a panic of zenoh is no Exception
        return f"{type(error).__name__}: {error}"
    return ""
