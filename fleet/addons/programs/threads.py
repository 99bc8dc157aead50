"""What stands in for `threading`: the threads of a program take turns, and wait in simulated time."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from itertools import count
from types import ModuleType
from typing import Any, ClassVar

from fleet.addons.programs.standard import stand_in
from fleet.addons.programs.turns import MAX_S, NS, Turns, Waiters


def thread_module(threading: ModuleType) -> ModuleType:
    """The module `_thread` of one program, as far as Python's own modules use it. `threading`: its own one."""

    def start(function: Callable[..., object], args: Any, kwargs: Mapping[str, Any] | None = None) -> int:
        thread = threading.Thread(target=function, args=args, kwargs=kwargs)
        thread.start()
        return int(thread.ident)

    return stand_in(
        ModuleType("_thread"), start_new_thread=start, allocate_lock=threading.Lock, LockType=threading.Lock,
        RLock=threading.RLock, get_ident=threading.get_ident, get_native_id=threading.get_ident, error=RuntimeError,
        TIMEOUT_MAX=MAX_S,
    )  # fmt: skip


class Threads:
    """The threads of one program, as its module `threading` knows them.

    Attributes:
        kinds: the classes of this program, by those of this module.
        known: threads that have begun and are not over, by their number.
    """

    def __init__(self, turns: Turns, write_error: Callable[[str], object]) -> None:
        """Have the main thread alone; the arguments are those of `threading_module`."""
        self.turns, self.write_error = turns, write_error
        self.numbers = count(1)
        self.known: dict[int, Thread] = {}
        self.kinds: dict[type, Any] = {}
        for kind in (Lock, RLock, Condition, Event, Semaphore, BoundedSemaphore, Barrier, Thread, Timer, Local):
            bases = [self.kinds[base] for base in kind.__bases__ if base in self.kinds]
            self.kinds[kind] = type(kind.__name__, (kind, *bases), {"_of_program": self})
        self.main: Thread = self.kinds[Thread](name="MainThread")
        self.main.ident = 1  # the first thread of the turns

    def get_ident(self) -> int:
        """The number of the thread whose turn it is."""
        return 0 if self.turns.current is None else self.turns.current.ident

    def current(self) -> Thread:
        """The thread whose turn it is."""
        return self.known.get(self.get_ident(), self.main)

    def every(self) -> list[Thread]:
        """All that are not over."""
        return [self.main, *self.known.values()]


class OfProgram:
    """Something whose class each program has for itself."""

    _of_program: ClassVar[Threads]


class Lock(OfProgram):
    """A lock; threads get it in the order in which they asked."""

    def __init__(self) -> None:
        self._owner, self._depth, self._waiters = 0, 0, Waiters(self._of_program.turns)

    reentrant = False

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if self._depth and not (self.reentrant and self._owner == self._of_program.get_ident()):
            if not blocking or not self._waiters.wait_s(None if timeout < 0 else timeout):
                return False  # otherwise who released it left it held, for this thread
            self._owner = self._of_program.get_ident()
            return True
        self._owner, self._depth = self._of_program.get_ident(), self._depth + 1
        return True

    def release(self) -> None:
        if not self._depth or (self.reentrant and self._owner != self._of_program.get_ident()):
            raise RuntimeError("cannot release un-acquired lock" if self.reentrant else "release unlocked lock")
        if self._depth > 1:
            self._depth -= 1
        elif not self._waiters.wake(1):
            self._depth = 0

    def locked(self) -> bool:
        return self._depth > 0

    def _at_fork_reinit(self) -> None:
        self._depth = 0

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()

    def give_up(self) -> int:
        """Release it whatever its depth, which `take_back` restores."""
        depth, self._depth = self._depth, 1
        self.release()
        return depth

    def take_back(self, depth: int) -> None:
        self.acquire()
        self._depth = depth


class RLock(Lock):
    """A lock that its owner may take again."""

    reentrant = True


class Condition(OfProgram):
    """Threads that wait until another one tells them that something has changed."""

    def __init__(self, lock: Any = None) -> None:
        self._lock = self._of_program.kinds[RLock]() if lock is None else lock
        self._waiters = Waiters(self._of_program.turns)
        self.acquire, self.release = self._lock.acquire, self._lock.release

    def __enter__(self) -> Any:
        return self._lock.__enter__()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def wait(self, timeout: float | None = None) -> bool:
        if not self._lock.locked():
            raise RuntimeError("cannot wait on un-acquired lock")
        depth = self._lock.give_up()
        try:
            return self._waiters.wait_s(timeout)
        finally:
            self._lock.take_back(depth)

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        turns = self._of_program.turns
        end, found = turns.until(timeout), predicate()
        while not found and (end is None or turns.now_ns < end):
            self.wait(None if end is None else (end - turns.now_ns) / NS)
            found = predicate()
        return found

    def notify(self, n: int = 1) -> None:
        if not self._lock.locked():
            raise RuntimeError("cannot notify on un-acquired lock")
        self._waiters.wake(n)

    def notify_all(self) -> None:
        self._waiters.wake()

    notifyAll = notify_all


class Event(OfProgram):
    """A flag to wait for."""

    def __init__(self) -> None:
        self._set, self._waiters = False, Waiters(self._of_program.turns)

    def is_set(self) -> bool:
        return self._set

    isSet = is_set

    def set(self) -> None:
        self._set = True
        self._waiters.wake()

    def clear(self) -> None:
        self._set = False

    def wait(self, timeout: float | None = None) -> bool:
        return self._set or self._waiters.wait_s(timeout) or self._set


class Semaphore(OfProgram):
    """A number of places."""

    def __init__(self, value: int = 1) -> None:
        if value < 0:
            raise ValueError("semaphore initial value must be >= 0")
        self._value, self._waiters = value, Waiters(self._of_program.turns)

    def acquire(self, blocking: bool = True, timeout: float | None = None) -> bool:
        if self._value:
            self._value -= 1
            return True
        return blocking and self._waiters.wait_s(timeout)

    def release(self, n: int = 1) -> None:
        self._value += n - self._waiters.wake(n)

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class BoundedSemaphore(Semaphore):
    """A number of places that does not grow."""

    def __init__(self, value: int = 1) -> None:
        super().__init__(value)
        self._most = value

    def release(self, n: int = 1) -> None:
        if self._value + n > self._most:
            raise ValueError("Semaphore released too many times")
        super().release(n)


class BrokenBarrierError(RuntimeError):
    """A barrier that nobody passes any more."""


class Barrier(OfProgram):
    """A place at which a number of threads wait for each other."""

    def __init__(self, parties: int, action: Callable[[], object] | None = None, timeout: float | None = None) -> None:
        self.parties, self._action, self._timeout = parties, action, timeout
        self.n_waiting, self.broken, self._waiters = 0, False, Waiters(self._of_program.turns)

    def wait(self, timeout: float | None = None) -> int:
        if self.broken:
            raise BrokenBarrierError
        place = self.parties - 1 - self.n_waiting
        self.n_waiting += 1
        if not place:
            self.n_waiting = 0
            if self._action is not None:
                self._action()
            self._waiters.wake()
        elif not self._waiters.wait_s(self._timeout if timeout is None else timeout) or self.broken:
            self.abort()
            raise BrokenBarrierError
        return place

    def reset(self) -> None:
        self.abort()
        self.broken = False

    def abort(self) -> None:
        self.broken, self.n_waiting = True, 0
        self._waiters.wake()


class Thread(OfProgram):
    """A thread of the program."""

    def __init__(
        self, group: None = None, target: Callable[..., object] | None = None, name: str | None = None,
        args: Any = (), kwargs: Mapping[str, Any] | None = None, *, daemon: bool | None = None,
    ) -> None:  # fmt: skip
        self._target, self._args, self._kwargs = target, tuple(args), dict(kwargs or {})
        self.name = name or f"Thread-{next(self._of_program.numbers)}"
        self.daemon = bool(daemon)
        self.ident: int | None = None
        self._over, self._waiters = False, Waiters(self._of_program.turns)

    native_id = property(lambda self: self.ident)

    def start(self) -> None:
        if self.ident is not None:
            raise RuntimeError("threads can only be started once")
        self.ident = self._of_program.turns.start(self._bootstrap).ident
        self._of_program.known[self.ident] = self

    def _bootstrap(self) -> None:
        try:
            self.run()
        except SystemExit:
            pass
        except Exception:
            self._of_program.write_error(f"Exception in thread {self.name}:\n{traceback.format_exc()}")
        finally:
            self._over = True
            self._of_program.known.pop(self.ident or 0, None)
            self._waiters.wake()

    def run(self) -> None:
        if self._target is not None:
            self._target(*self._args, **self._kwargs)

    def join(self, timeout: float | None = None) -> None:
        if self.ident is None:
            raise RuntimeError("cannot join thread before it is started")
        if not self._over:
            self._waiters.wait_s(timeout)

    def is_alive(self) -> bool:
        return self.ident is not None and not self._over

    def getName(self) -> str:
        return self.name

    def setName(self, name: str) -> None:
        self.name = name

    def isDaemon(self) -> bool:
        return self.daemon

    def setDaemon(self, daemon: bool) -> None:
        self.daemon = daemon


class Timer(Thread):
    """A call after a time."""

    def __init__(
        self, interval: float, function: Callable[..., object], args: Any = None,
        kwargs: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        self.interval, self.function, self.args, self.kwargs = interval, function, args or (), kwargs or {}
        self.finished = self._of_program.kinds[Event]()

    def cancel(self) -> None:
        self.finished.set()

    def run(self) -> None:
        if not self.finished.wait(self.interval):
            self.function(*self.args, **self.kwargs)
        self.finished.set()


class Local(OfProgram):
    """Values of each thread."""

    def __init__(self) -> None:
        object.__setattr__(self, "_values", {})

    def __getattribute__(self, name: str) -> Any:
        values = _own_values(self)
        return values[name] if name in values else object.__getattribute__(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        _own_values(self)[name] = value


def _own_values(local: Local) -> dict[str, Any]:
    """The attributes of a `Local` in the thread whose turn it is."""
    values: dict[int, dict[str, Any]] = object.__getattribute__(local, "_values")
    return values.setdefault(type(local)._of_program.get_ident(), {})


def threading_module(turns: Turns, write_error: Callable[[str], object]) -> ModuleType:
    """The module `threading` of one program.

    Args:
        turns: its threads.
        write_error: gets the traceback of a thread that failed, as `sys.stderr` would.

    Returns:
        The module.
    """
    threads = Threads(turns, write_error)
    return stand_in(
        ModuleType("threading"), **{kind.__name__: own for kind, own in threads.kinds.items()},
        local=threads.kinds[Local], BrokenBarrierError=BrokenBarrierError, current_thread=threads.current,
        currentThread=threads.current, main_thread=lambda: threads.main, enumerate=threads.every,
        active_count=lambda: len(threads.every()), get_ident=threads.get_ident, get_native_id=threads.get_ident,
        TIMEOUT_MAX=MAX_S, ThreadError=RuntimeError, _register_atexit=lambda call, *_, **__: None,
    )  # fmt: skip
