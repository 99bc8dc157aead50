"""Threads, and what to say where the system gives none."""

from __future__ import annotations

import threading

from fleet.errors import RunBroken

NO_THREAD = "can't start new thread"  # what Python says, also in a callback of zenoh or in the log of a process


def start(thread: threading.Thread) -> None:
    """Start a thread.

    Raises:
        RunBroken: the system allows no more.
    """
    try:
        thread.start()
    except (RuntimeError, MemoryError) as error:
        raise no_thread(error) from None


def no_thread(error: object) -> RunBroken:
    """What to say where the system allows no more."""
    return RunBroken(
        f"cannot start a thread ({error}): the limit of processes and threads, or of memory, is reached; raise it "
        "(ulimit -u, ulimit -v, TasksMax= of a systemd unit, --pids-limit of a container), or take --in-process, "
        "which needs the fewest"
    )
