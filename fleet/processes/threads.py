"""Threads, and what to say where the system gives none."""

from __future__ import annotations

import threading

from fleet.errors import RunBroken


def start(thread: threading.Thread) -> None:
    """Start a thread.

    Raises:
        RunBroken: the system allows no more.
    """
    try:
        thread.start()
    except (RuntimeError, MemoryError) as error:
        raise RunBroken(
            f"cannot start a thread ({error}): the limit of processes and threads, or of memory, is reached; raise it "
            "(ulimit -u, ulimit -v, TasksMax= of a systemd unit, --pids-limit of a container), or take --in-process, "
            "which needs the fewest"
        ) from None
