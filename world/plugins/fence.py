"""The fence round a plug-in: what it raises, returns and prints, and how long it takes.

Every failure becomes one error of the plug-in's kind, which names tick and line.
"""

from __future__ import annotations

import re
import signal
import sys
import threading
from bdb import BdbQuit
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager, redirect_stdout
from io import TextIOBase
from itertools import islice
from math import isfinite, nan
from multiprocessing import parent_process
from time import perf_counter, thread_time
from types import FrameType
from typing import Any

from world.errors import FmuError
from world.plugins.checks import MAX_NUMBERS
from world.plugins.error_place import is_in_library, place_of, place_of_line, place_of_method, words_of
from world.signal import Signal
from world.vectors import Vec3

Failure = Callable[[int, str, str], Exception]  # the error for a tick, a problem, and the line or ""


class OverBudgetError(BaseException):
    """Raised inside a plug-in by the timer; no Exception, so that the plug-in cannot take it for one of its own."""


class Fence:
    """Calls one plug-in, and checks what comes back.

    Args:
        name: of the plug-in, as the scenario names it.
        budget_s: the longest time that a call may take [s]. With 0 it may take any time.
        notes: list that receives (tick, note for the user).
        failure: makes the errors.
        patience: factor on the budget for a call that hardly computes. Such a call waits, or the system suspended its
            process or gave it no processor. Use it if the result must not depend on other work of the machine.
    """

    def __init__(
        self, name: str, budget_s: float, notes: list[tuple[int, str]], failure: Failure, patience: int = 1
    ) -> None:
        self._name = name.rpartition(":")[2]
        self._budget_s, self._patience = budget_s, patience
        self._failure = failure
        self._printed = _Printed(self)
        self._tick = 0
        self._notes = notes

    def make(self, plugin_class: type[Any], config: Any, parameters: Mapping[str, Any]) -> Any:
        """An instance of the plug-in. This may take longer than the budget, which is for samples."""
        return self._call(0, False, plugin_class, config, **parameters)

    def call(self, tick: int, function: Callable[..., Any], *args: Any) -> Any:
        """The result of a function of the plug-in.

        Raises:
            Exception: the `failure` of this fence: it raised, or took longer than its budget.
        """
        return self._call(tick, True, function, *args)

    def _call(self, tick: int, timed: bool, function: Callable[..., Any], /, *args: Any, **named: Any) -> Any:
        self._tick = tick
        try:
            with redirect_stdout(self._printed):
                if not (timed and self._budget_s):
                    return function(*args, **named)
                with self._timer():
                    return function(*args, **named)
        except OverBudgetError as error:
            took = f"{self._name} took longer than its budget of {self._budget_s * 1e3:g} ms"
            raise self._failure(tick, took, place_of(error) or place_of_method(function)) from None
        except BaseException as error:  # SystemExit, too: a plug-in may fail, but not end the run as if all were well
            by_hand = isinstance(error, (KeyboardInterrupt, BdbQuit))  # Ctrl-C, `q` in the debugger
            if by_hand and parent_process() is None:
                raise KeyboardInterrupt from None
            # An FMU's words are about itself; a class of the user's raises something.
            said = str(error) if isinstance(error, FmuError) else f"raised {words_of(error)}"
            problem = f"{self._name} {said}"
            if isinstance(error, BdbQuit):  # an agent process has no terminal
                problem += ": to debug, run it with --in-process"
            raise self._failure(tick, problem, place_of(error) or place_of_method(function)) from error

    def wrong(self, tick: int, method: Any, problem: str) -> Exception:
        """The error for an answer that cannot be used."""
        return self._failure(tick, f"{self._name} {problem}", place_of_method(method))

    def vector(self, tick: int, method: Any, what: str, value: Any) -> Vec3:
        """`value` as three finite numbers."""
        if type(value) is tuple and len(value) == 3 and all(type(one) is float and isfinite(one) for one in value):
            return value
        numbers = numbers_of(value)
        if len(numbers) != 3:
            raise self.wrong(tick, method, f"returned {what} {show_value(value)}: expected three numbers")
        x, y, z = numbers
        if not all(map(isfinite, numbers)):
            raise self.wrong(tick, method, f"returned {what} {(x, y, z)}: every number must be finite")
        return x, y, z

    def telemetry(self, tick: int, method: Any, signals: Sequence[Signal], values: Any) -> tuple[float, ...]:
        """The values of `signals` as one flat tuple."""
        if not isinstance(values, Mapping):
            raise self.wrong(tick, method, f"returned telemetry {show_value(values)}: expected a dict by signal name")
        if values.keys() != {signal.name for signal in signals}:
            missing = sorted({signal.name for signal in signals} - values.keys())
            unknown = sorted(map(str, values.keys() - {signal.name for signal in signals}))
            text = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"adds {', '.join(unknown)}"] * bool(unknown)
            raise self.wrong(
                tick, method, f"returned telemetry that {' and '.join(text)}; signals declare what is there"
            )
        flat: list[float] = []
        for signal_ in signals:
            value = values[signal_.name]
            if (type(value) is float or type(value) is int) and isfinite(value) and signal_.width == 1:
                flat.append(float(value))  # nearly all are, and the general way costs ten times as much
                continue
            if value is None:  # not known yet
                flat += (nan,) * signal_.width
                continue
            numbers = (hasattr(value, "__iter__") and numbers_of(value)) or numbers_of((value,))
            if len(numbers) != signal_.width:
                expected = "a number" if signal_.width == 1 else f"{signal_.width} numbers"
                raise self.wrong(tick, method, f"returned {signal_.name} = {show_value(value)}: expected {expected}")
            if not all(map(isfinite, numbers)):
                problem = f"returned {signal_.name} = {show_value(value)}: every number must be finite"
                raise self.wrong(tick, method, problem)
            flat += numbers
        return tuple(flat)

    def note_print(self, text: str) -> None:
        """Note that the plug-in prints, and where; only the first time."""
        if self._printed.noted:
            return
        self._printed.noted = True
        caller = sys._getframe(2)  # behind this and `_Printed.write`
        frame: FrameType | None = caller
        while frame is not None and is_in_library(frame.f_code.co_filename):  # pprint, say: the plug-in called it
            frame = frame.f_back
        if frame is None or frame.f_code.co_filename == __file__:  # the plug-in is itself an installed one
            frame = caller
        where = place_of_line(frame.f_code.co_filename, frame.f_lineno)
        self._notes.append((self._tick, f"{self._name} prints ({where}): {text.strip()[:200]!r}; see the process log"))

    @contextmanager
    def _timer(self) -> Iterator[None]:
        budget_s, patience = self._budget_s, self._patience
        began, computed = perf_counter(), thread_time() if patience > 1 else 0.0

        def over() -> bool:
            passed_s = perf_counter() - began
            if patience == 1 or passed_s > patience * budget_s:
                return passed_s > budget_s
            return passed_s > budget_s and thread_time() - computed > budget_s / 2

        # Only a main thread gets signals; elsewhere the time is looked at when the plug-in is back.
        if threading.current_thread() is threading.main_thread():
            with alarm(budget_s, budget_s if patience > 1 else 0.0, over):
                yield
        else:
            yield
        if over():  # a plug-in that swallowed the signal, or never left C code
            raise OverBudgetError


@contextmanager
def alarm(after_s: float, again_s: float, over: Callable[[], bool]) -> Iterator[None]:
    """Raise `OverBudgetError` in the code inside after a time; a timer that was set before goes on afterwards.

    Args:
        again_s: how often it is asked again whether it is over; 0: the first alarm ends it.
        over: whether it is.
    """

    def ring(number: int, frame: FrameType | None) -> None:
        if not again_s or over():
            raise OverBudgetError

    began = perf_counter()
    left_s = interval_s = 0.0
    before = signal.signal(signal.SIGALRM, ring)
    try:
        left_s, interval_s = signal.setitimer(signal.ITIMER_REAL, after_s, again_s)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.signal(signal.SIGALRM, before)
        if left_s:
            signal.setitimer(signal.ITIMER_REAL, max(1e-6, left_s - (perf_counter() - began)), interval_s)


def numbers_of(value: Any) -> list[float]:
    """`value` as numbers; none if it is anything else. A text, a set or a dict is no vector, though it has a length."""
    if isinstance(value, (str, bytes, bytearray, Mapping, Set)):
        return []
    try:
        items = list(islice(value, MAX_NUMBERS + 1))  # an endless generator, too, has an end here
        return [] if any(isinstance(item, (str, bytes)) for item in items) else [float(item) for item in items]
    except Exception:  # whatever the user's objects raise when they are asked
        return []


def show_value(value: Any) -> str:
    """A value as messages show it: on one line, and the same in every run."""
    try:
        return re.sub(r" at 0x[0-9a-f]+", "", " ".join(repr(value).split()))[:80]
    except Exception:
        return f"a {type(value).__name__}"


class _Printed(TextIOBase):
    """Where a plug-in's prints go: to standard error, which in a process is its log. Debuggers work with it."""

    def __init__(self, fence: Fence) -> None:
        self._fence = fence
        self.noted = False

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        if text.strip():
            self._fence.note_print(text)
        return sys.stderr.write(text)

    def flush(self) -> None:
        sys.stderr.flush()
