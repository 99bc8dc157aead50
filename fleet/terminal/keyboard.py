"""Single key presses from a terminal, whose settings are restored at the end, also before a Ctrl-Z."""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
import time
import tty
from enum import Enum
from types import FrameType, TracebackType
from typing import Any


class Key(Enum):
    """The meaning of a key for a player."""

    PAUSE = "space"
    STEP = "right arrow"
    FASTER = "up arrow"
    SLOWER = "down arrow"
    FORWARD = "] or shift + right arrow"
    BACK = "[ or shift + left arrow"


# xterm's sequences, which every common terminal emulator sends: ESC [ A, with a modifier ESC [ 1 ; 2 C.
_SEQUENCES = {
    b" ": Key.PAUSE,
    b"\x1b[C": Key.STEP,
    b"\x1bOC": Key.STEP,
    b"\x1b[A": Key.FASTER,
    b"\x1bOA": Key.FASTER,
    b"\x1b[B": Key.SLOWER,
    b"\x1bOB": Key.SLOWER,
    b"]": Key.FORWARD,
    b"\x1b[1;2C": Key.FORWARD,
    b"[": Key.BACK,
    b"\x1b[1;2D": Key.BACK,
}


def decode(typed: bytes) -> tuple[list[Key], bytes]:
    """The keys in the bytes typed, and the bytes that may begin another one. Other bytes are skipped."""
    keys: list[Key] = []
    while typed:
        if typed[:1] != b"\x1b":
            length = 1
        elif len(typed) == 1 or typed in (b"\x1b[", b"\x1bO"):
            return keys, typed
        elif typed[1:2] not in b"[O":
            length = 1  # a lone escape; what follows is a key of its own
        else:
            end = next((n for n, byte in enumerate(typed[2:], start=2) if 0x40 <= byte <= 0x7E), None)
            if end is None:
                return keys, typed if len(typed) < 16 else b""
            length = end + 1
        if (key := _SEQUENCES.get(typed[:length])) is not None:
            keys.append(key)
        typed = typed[length:]
    return keys, b""


class Keyboard:
    """Key presses from stdin while the `with` block lasts; without a terminal there are none."""

    @staticmethod
    def possible() -> bool:
        """Whether key presses can be read: stdin is a terminal, and this is not a background job."""
        return sys.stdin is not None and sys.stdin.isatty() and not _is_in_background(sys.stdin.fileno())

    def __init__(self) -> None:
        self._descriptor: int | None = None
        self._before: list[Any] = []
        self._typed = b""
        self._suspended_ns = 0

    def __enter__(self) -> Keyboard:
        if self.possible():
            self._descriptor = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._descriptor)
            signal.signal(signal.SIGTSTP, self._suspend)
            tty.setcbreak(self._descriptor)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._descriptor is not None:
            self._restore()
            signal.signal(signal.SIGTSTP, signal.SIG_DFL)

    @property
    def there(self) -> bool:
        """Whether key presses are read."""
        return self._descriptor is not None

    def suspended_ns(self) -> int:
        """For how long the program was suspended since the last call [ns]."""
        suspended, self._suspended_ns = self._suspended_ns, 0
        return suspended

    def read(self, timeout_s: float) -> list[Key]:
        """The keys that were pressed; waits for the first one at most for this time."""
        if self._descriptor is None:
            time.sleep(timeout_s)
            return []
        if not select.select([self._descriptor], [], [], timeout_s)[0]:
            return []
        typed = os.read(self._descriptor, 1024)
        if not typed:  # the terminal is gone
            self._descriptor = None
            return []
        keys, self._typed = decode(self._typed + typed)
        return keys

    def _restore(self) -> None:
        assert self._descriptor is not None
        termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def _suspend(self, number: int, frame: FrameType | None) -> None:
        # Ctrl-Z: the shell gets the terminal as it was; when we continue, we set it again.
        self._restore()
        left_ns = time.monotonic_ns()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._suspended_ns += time.monotonic_ns() - left_ns
        if self._descriptor is not None:
            tty.setcbreak(self._descriptor)


def _is_in_background(terminal: int) -> bool:
    """Whether this is a background job, which the system would stop for touching the terminal."""
    try:
        return os.getpgrp() != os.tcgetpgrp(terminal)
    except OSError:  # a terminal, but not the one that controls us
        return False
