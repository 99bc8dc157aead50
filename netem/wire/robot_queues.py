"""The two queues of a robot: what its programs send to the relay, and what the relay has for them. Both are bounded.

A thread hands each robot what is due for it, so a program that is slow or stopped keeps no other robot waiting.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Hashable
from queue import SimpleQueue
from threading import Lock, Thread
from time import monotonic_ns
from typing import Any, NamedTuple

from netem.errors import BusError
from netem.limits import RELAY_WAITING, ROBOT_WAITING

_MOST_KINDS = 1000  # kinds of messages that did not fit and are not taken yet


class Inlet:
    """The way of one sender into a queue that others use, too: what waits there is bounded, and what does not fit is
    counted. Several threads let in, and one takes out.
    """

    def __init__(self, put: Callable[[Any], None]) -> None:
        """`put`: of the queue. What needs no bounds may call it, too."""
        self.put = put
        self._lock = Lock()
        self._waiting = self._bytes = 0
        self._unfit: Counter[Hashable] = Counter()

    def offer(self, item: Any, size: int, name: Callable[[], Hashable]) -> None:
        """Put an item of `size` bytes, or count it by its name: too much waits."""
        with self._lock:
            if self._waiting and (self._waiting >= RELAY_WAITING.items or self._bytes + size > RELAY_WAITING.bytes):
                what = name() if len(self._unfit) < _MOST_KINDS else None
                self._unfit[what] += 1
                return
            self._waiting += 1
            self._bytes += size
            self.put(item)

    def release(self, size: int) -> None:
        """An item that waited was taken out."""
        with self._lock:
            self._waiting -= 1
            self._bytes -= size

    def unfit(self) -> Counter[Hashable]:
        """What did not fit since the last call, by name; None counts those beyond the most names."""
        if not self._unfit:
            return Counter()
        with self._lock:
            found, self._unfit = self._unfit, Counter()
        return found


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
