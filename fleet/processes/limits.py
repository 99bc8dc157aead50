"""This machine's limits for a run: open files (many processes need more than usual), threads, and processors."""

from __future__ import annotations

import os
import resource
import threading

from fleet.errors import RunBroken

# Measured: the console holds 16 and two per agent, the world 14 and one per agent; more while they start.
FILES, FILES_PER_VEHICLE = 48, 2
FILES_PER_WORKER = 3  # the pipe of a worker, and two files of multiprocessing
MOST_VEHICLES = 1000
NO_THREAD = "can't start new thread"  # what Python says, also in a callback of zenoh or in the log of a process


def allow_most_open_files() -> None:
    """Raise the soft limit as far as the largest run needs it and the hard limit allows; children inherit it."""
    _raise_to(FILES + FILES_PER_VEHICLE * MOST_VEHICLES)


def allow_open_files(vehicles: int, others: int = 0) -> None:
    """Raise the soft limit of open files to what a run needs; child processes inherit it. The `others`, connections
    from outside of the run, get room as far as the hard limit allows. Raises RunBroken if the hard limit is too low.
    """
    needed = FILES + FILES_PER_VEHICLE * vehicles
    limit = _raise_to(needed + others)
    if limit < needed:
        raise RunBroken(
            f"{vehicles} vehicles need {needed} open files per process, and the limit here is {limit}; raise it "
            f"(ulimit -n {needed}, or LimitNOFILE= of a systemd unit), or take --in-process, which needs none of them"
        )


def allow_workers(count: int) -> None:
    """Raise the soft limit as far as `count` worker processes need it; each inherits it. Raises RunBroken if
    the hard limit is too low.
    """
    needed = len(os.listdir("/proc/self/fd")) + FILES + FILES_PER_WORKER * count
    limit = _raise_to(needed)
    if limit < needed:
        raise RunBroken(
            f"{count} workers need {needed} open files in this process, and the limit here is {limit}; raise it "
            f"(ulimit -n {needed}), or take fewer with --workers"
        )


def _raise_to(wanted: int) -> int:
    """Raise the soft limit to `wanted` files, or to the hard limit if that is lower; returns how many may be open."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return wanted
    limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if limit > soft:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
    return limit


def start_thread(thread: threading.Thread) -> None:
    """Start a thread. Raises RunBroken: the system allows no more."""
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


def processors() -> int:
    """How many processors this program may use, where somebody has limited this process (taskset, a container), too."""
    return len(os.sched_getaffinity(0))
