"""The threads of one program, which take turns: one order, in simulated time."""

from __future__ import annotations

import sys
from asyncio import events
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from heapq import heappop, heappush
from itertools import count
from typing import Any

from greenlet import GreenletExit, getcurrent, greenlet

NS = 10**9
MAX_S = 1e9  # the longest wait that a program may ask for
_MOST_REFUSED = 100  # waits of a program that was ended


class Waiters:
    """Threads that wait for one thing, the first one first."""

    def __init__(self, turns: Turns) -> None:
        self._turns = turns
        self._threads: deque[ProgramThread] = deque()

    def wait(self, until_ns: int | None = None) -> bool:
        """Let the thread whose turn it is wait. Returns whether it was woken before its time had come."""
        thread = self._turns.current
        assert thread is not None, "something of a program is used outside of its turn"
        self._threads.append(thread)
        if self._turns.wait(until_ns):
            return True
        if thread in self._threads:
            self._threads.remove(thread)
        return False

    def wait_s(self, timeout_s: float | None) -> bool:
        """The same, for a time from now on [s]; None: without an end."""
        return self.wait(self._turns.until(timeout_s))

    def wake(self, most: int | None = None) -> int:
        """Wake so many of them, or all. Returns how many there were."""
        woken = 0
        while self._threads and woken != most:
            woken += self._turns.wake(self._threads.popleft())
        return woken


class ProgramThread:
    """One thread of a program. Only one runs at a time, and only a wait gives the turn to another one."""

    def __init__(self, ident: int, call: Callable[[], object]) -> None:
        self.ident = ident
        self.task = greenlet(call)
        self.waits = 0  # how often it has waited, so that an old alarm wakes no later wait
        self.waiting = False
        self.woken = False  # by somebody; else its time has come


class Turns:
    """The threads of a program, and its clock.

    Attributes:
        now_ns: the time of the program's clock, from the beginning of the run.
        over: the program was ended; nothing that it still does has an effect.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self.over = False
        self.current: ProgramThread | None = None
        self._hub: greenlet | None = None
        self._idents = count(1)
        self._order = count()
        self._ready: deque[ProgramThread] = deque()
        self._threads: list[ProgramThread] = []
        self.at_end: list[Callable[[], object]] = []  # called when the program is ended
        self._alarms: list[tuple[int, int, ProgramThread, int]] = []

    def start(self, call: Callable[[], object]) -> ProgramThread:
        """A new thread, whose first turn comes after those that are ready."""
        thread = ProgramThread(next(self._idents), call)
        self._threads.append(thread)
        self._ready.append(thread)
        return thread

    def wait(self, until_ns: int | None = None) -> bool:
        """Give the turn away.

        Args:
            until_ns: when the thread goes on at the latest; None: only if somebody wakes it.

        Returns:
            Whether somebody woke it before the time had come.
        """
        thread = self.current
        if self.over:
            self._refused += 1
            if self._refused > _MOST_REFUSED and self._hub is not None:
                self._hub.switch()  # it catches everything, and goes on: it stays where it is
            raise GreenletExit
        if thread is None:
            raise GreenletExit  # its module is used from outside of its turn
        thread.waits += 1
        thread.waiting, thread.woken = True, False
        if until_ns is not None:
            heappush(self._alarms, (until_ns, next(self._order), thread, thread.waits))
        assert self._hub is not None
        running, hooks = events._get_running_loop(), sys.get_asyncgen_hooks()  # a callback of a loop may wait, too
        events._set_running_loop(None)
        sys.set_asyncgen_hooks(None, None)
        self._hub.switch()
        events._set_running_loop(running)
        sys.set_asyncgen_hooks(*hooks)
        if self.over:
            raise GreenletExit
        return thread.woken

    def until(self, timeout_s: float | None) -> int | None:
        """When a wait that begins now is over [ns]. `timeout_s`: how long it may last; None: without an end."""
        return None if timeout_s is None else self.now_ns + round(max(0.0, min(timeout_s, MAX_S)) * NS)

    def wake(self, thread: ProgramThread) -> bool:
        """Let a thread that waits go on, after those that are ready. False: it waits no more, its time has come."""
        if not thread.waiting:
            return False
        thread.waiting, thread.woken = False, True
        self._ready.append(thread)
        return True

    def advance(self, now_ns: int) -> None:
        """Let all threads run that can at a time, until each waits. What one of them raises passes on."""
        self.now_ns, self._hub = now_ns, getcurrent()
        while True:
            while self._alarms and self._alarms[0][0] <= now_ns:
                _, _, thread, number = heappop(self._alarms)
                if thread.waiting and thread.waits == number:
                    thread.waiting = False
                    self._ready.append(thread)
            if not self._ready:
                return
            thread = self._ready.popleft()
            self.current, thread.task.parent = thread, self._hub
            try:
                thread.task.switch()
            finally:
                self.current = None
            if thread.task.dead:
                self._threads.remove(thread)

    def call(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Let a thread of its own call a function of the program, as a library's thread would."""
        self.start(lambda: function(*arguments))

    def end(self) -> None:
        """End the program: its threads unwind, and nothing that they do meanwhile has an effect.

        The collector cannot free a thread that waits, because it does not see what its frames hold.
        """
        self.over, self._refused = True, 0
        for call in self.at_end:
            call()
        threads, self._threads = self._threads, []
        self._ready.clear()
        self._alarms.clear()
        self._hub = getcurrent()
        for thread in threads:
            thread.task.parent = self._hub
            with suppress(BaseException):
                thread.task.throw(GreenletExit)
