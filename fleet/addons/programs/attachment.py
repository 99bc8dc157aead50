"""Who sits at the program of an agent, at its terminal or with a debugger, while the sea waits."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Attachment:
    """What a user asks for: to sit at the program of one agent."""

    agent: int
    gdb: bool
    at_ns: int = 0  # when gdb is attached [ns of the run]


_now: Attachment | None = None  # of the run that goes on in this process


@contextmanager
def attach(to: Attachment) -> Iterator[None]:
    """Let the agent of a run that goes on inside find what is asked for."""
    global _now
    _now = to
    try:
        yield
    finally:
        _now = None


def attachment(agent: int) -> Attachment | None:
    """Who sits at the program of an agent; None: nobody does."""
    return _now if _now is not None and _now.agent == agent else None


def take_terminal() -> None:
    """Take the terminal back from a program that has ended."""
    before = signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # who is in the background is stopped for it
    try:
        os.tcsetpgrp(0, os.getpgrp())
    except OSError:
        return  # it is gone
    finally:
        signal.signal(signal.SIGTTOU, before)


def start_gdb(pid: int) -> subprocess.Popen[bytes] | None:
    """Attach gdb to a process, which stands until gdb lets it go on.

    Args:
        pid: the process.

    Returns:
        The debugger; None: it has ended before it was attached.
    """
    text = "gdb has the program: set breakpoints, then `continue`; time stands still while it does.\n"
    os.write(1, text.encode())  # not print, which would be a note of a law
    commands = ["set pagination off", "handle SIGSYS nostop noprint pass"]  # SIGSYS: how its system calls are trapped
    asked = [part for each in commands for part in ("-iex", each)]
    gdb = subprocess.Popen(["gdb", "-q", *asked, "-p", str(pid)])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is gdb's
    while gdb.poll() is None:
        try:
            if "TracerPid:\t0\n" not in Path(f"/proc/{pid}/status").read_text():
                return gdb
        except OSError:
            return None
        time.sleep(0.02)
    return None
