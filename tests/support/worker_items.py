"""What worker processes of a test do: they import it from here."""

from __future__ import annotations

import os
import signal
import sys
import time
from functools import partial
from pathlib import Path
from types import ModuleType

from fleet.processes.apart import in_child_process


def step(number: int) -> int:
    """Twice the number; kills its process for a negative one, and fails for zero."""
    if number < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 0:
        raise ZeroDivisionError
    return 2 * number


def die_once(mark: Path) -> int:
    """The number of this process, which is killed if there is no such file yet."""
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die_at_once() -> None:
    """Ends its process with a status of its own."""
    os._exit(7)


def hang() -> None:
    """Ends with its process alone."""
    time.sleep(3600.0)


def sleep(seconds: float) -> float:
    """Returns the seconds after so long."""
    time.sleep(seconds)
    return seconds


def unpicklable(number: int) -> None:
    """Raises an exception that no other process can load, or SystemExit."""

    class LocalError(Exception):
        pass

    raise LocalError("only here") if number == 0 else SystemExit(number)


def known_to_the_worker_alone(number: int) -> object:
    """Raises, or for 1 returns, what can be loaded in this process, and in no other one."""
    module = sys.modules["only_here"] = ModuleType("only_here")
    exec("class OddError(BaseException): ...", vars(module))
    if number == 1:
        return module.OddError()
    raise module.OddError


def masked(_: object) -> set[signal.Signals | int]:
    """The signals that do not reach this process."""
    return signal.pthread_sigmask(signal.SIG_BLOCK, ())


def copied(number: int) -> tuple[list[int], list[int]]:
    """What three copies of this process make of a list, one after the other, and the list; none is left."""
    known = [number]

    def add(more: int) -> int:
        known.append(more)
        return sum(known)

    found = [in_child_process(partial(add, more)) for more in (1, 2, 3)]
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return found, known
    raise RuntimeError("a copy is left")


def step_apart(number: int) -> int:
    """As `step`, in a copy of this process."""
    return in_child_process(partial(step, number))


def hang_apart() -> None:
    """Has a copy of this process write its number to standard output, and wait for ever."""

    def on_progress() -> None:
        os.write(1, f"{os.getpid()}\n".encode())
        hang()

    in_child_process(on_progress)
