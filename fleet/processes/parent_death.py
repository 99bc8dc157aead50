"""Ask the kernel to kill this process when its parent dies, so that no process outlives its run.

The children of a fork server are not the console's children and would survive its kill -9. So the fork server asks
for its end with the console, and each child for its end with the fork server, by PR_SET_PDEATHSIG (prctl(2)). The
signal follows the *thread* that forked, so the fork server must be started from the console's main thread.
"""

from __future__ import annotations

import ctypes
import os
import signal

CONSOLE_PID_VARIABLE = "UUV_FLEET_CONSOLE_PID"  # tells the fork server its parent

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent_pid: int) -> None:
    """SIGKILL this process when its parent dies; exit now if `parent_pid` is not the parent any more."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    # The parent may have died before the call took effect.
    if os.getppid() != parent_pid:
        os._exit(1)
