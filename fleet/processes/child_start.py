"""How a child process of Python starts: tied to its parent, without our main module, safe from modules that lie about.

The kernel kills a process when its parent dies, so that none outlives its run. The children of a fork server are not
the console's children and would survive its kill -9. So the fork server asks for its end with the console, and each
child for its end with the fork server, by PR_SET_PDEATHSIG (prctl(2)). The signal follows the *thread* that forked,
so the fork server must be started from the console's main thread.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType

CONSOLE_PID_VARIABLE = "UUV_FLEET_CONSOLE_PID"  # tells the fork server its parent
PRELOAD_VARIABLE = "UUV_FLEET_PRELOAD"  # tells the fork server what its children run

PARENT_PID_VARIABLE = "UUV_FLEET_PARENT_PID"  # tells a command that a study starts whom it must not outlive

_PR_SET_PDEATHSIG = 1
_SAFE_PATH, _OURS = "PYTHONSAFEPATH", "uuv-fleet"  # any value is a yes: by this one we know that the user set none


def die_with_parent(parent_pid: int) -> None:
    """SIGKILL this process when its parent dies; exit now if `parent_pid` is not the parent any more."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    # The parent may have died before the call took effect.
    if os.getppid() != parent_pid:
        os._exit(1)


def die_with_study() -> None:
    """Tie this process to the study that has started it, if one has."""
    if parent := os.environ.pop(PARENT_PID_VARIABLE, ""):
        die_with_parent(int(parent))


@contextmanager
def without_main() -> Iterator[None]:
    """Processes that are started within do not import our main module, and with it the whole command line. So a script
    that starts workers needs no `if __name__ == "__main__":`.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def children_ignore_the_folder() -> None:
    """Python processes that start from now on do not import a `socket.py` in the current directory for Python's."""
    # multiprocessing starts its fork server with `python -c`, which looks for every module in the current directory
    # first.
    os.environ[_SAFE_PATH] = os.environ.get(_SAFE_PATH) or _OURS


def program_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment as programs of the user get it: theirs import modules that lie beside them."""
    return {name: value for name, value in environment.items() if (name, value) != (_SAFE_PATH, _OURS)}
