"""The limit of open files, which a run of many processes needs to be higher than usual."""

from __future__ import annotations

import resource

from fleet.errors import RunBroken

# Measured: the console holds 16 and two per agent, the world 14 and one per agent; more while they start.
FILES, FILES_PER_VEHICLE = 48, 2


MOST_VEHICLES = 1000


def allow_most_open_files() -> None:
    """Raise the soft limit as far as the largest run needs it and the hard limit allows; children inherit it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES + FILES_PER_VEHICLE * MOST_VEHICLES
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def allow_open_files(vehicles: int, others: int = 0) -> None:
    """Raise the soft limit as far as a run needs it; children inherit it.

    Args:
        others: connections from outside of the run; there is room for them as far as the hard limit allows.

    Raises:
        RunBroken: the hard limit is too low.
    """
    needed = FILES + FILES_PER_VEHICLE * vehicles
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = needed + others
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise RunBroken(
            f"{vehicles} vehicles need {needed} open files per process, and the limit here is {hard}; raise it "
            f"(ulimit -n {needed}, or LimitNOFILE= of a systemd unit), or take --in-process, which needs none of them"
        )
    limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
