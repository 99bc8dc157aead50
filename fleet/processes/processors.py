"""How many processors this program may use."""

from __future__ import annotations

import os


def processors() -> int:
    """Those of the machine, or fewer where somebody has limited this process (taskset, a container)."""
    return len(os.sched_getaffinity(0))
