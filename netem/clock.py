"""The two clocks that can decide when a tick begins."""

from __future__ import annotations

from enum import StrEnum


class Clock(StrEnum):
    """Decides when a tick begins."""

    LOCKSTEP = "lockstep"  # everybody waits for everybody, so the log does not depend on the machine
    REAL = "real"  # the wall clock: no process waits, so each can be late
