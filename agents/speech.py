"""What an agent says for the log: a part of it with each command, in order; what there is no room for is counted."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from netem.wire.messages import END, ERR, FAILED, OUT, Said

STREAMS = frozenset({OUT, ERR, END, FAILED})
LAST = frozenset({END, FAILED})
LONGEST = 1_000  # characters of a line
MOST_LINES = 200  # with one command
MOST_BYTES = 16_000  # of lines with one command, which has to fit into a message with all else that is in it
MOST_WAITING = 2_000  # lines that wait for later commands
_HEAD_BYTES = 24  # of a line, besides its text


def usable(said: object) -> bool:
    """Whether this is a line: a user's code made it, and nobody has checked its fields."""
    return (
        isinstance(said, Said)
        and isinstance(said.at_ns, int)
        and 0 <= said.at_ns < 2**63
        and said.stream in STREAMS
        and isinstance(said.text, str)
    )


def shortened(text: str) -> str:
    """A text as a line may have it: not too long, and of characters that UTF-8 has."""
    if len(text) > LONGEST:
        text = text[: LONGEST - 1] + "…"
    return text.encode("utf-8", "replace").decode()


class Speech:
    """The lines of one agent that no command has carried yet.

    If there are too many, the oldest are left out: what was said last, before a program ended, tells most. How it ended
    is the last line that counts, and waits for no other: the run may be over before those have left.
    """

    def __init__(self) -> None:
        self._waiting: deque[Said] = deque()
        self._bytes = 0
        self._left_out = 0
        self._over = False  # it has said how it ended

    def put(self, lines: Iterable[Said]) -> None:
        """Add what was said since the last call."""
        for said in lines:
            if self._over:
                return
            line = Said(said.at_ns, said.stream, shortened(said.text))
            self._waiting.append(line)
            self._bytes += _size(line)
            self._over = said.stream in LAST
            if len(self._waiting) > MOST_WAITING:
                self._drop()

    def take(self) -> tuple[Said, ...]:
        """The lines for the next command."""
        waiting = self._waiting
        if not waiting:
            return ()
        while self._over and (len(waiting) >= MOST_LINES or self._bytes > MOST_BYTES):
            self._drop()
        taken = []
        if self._left_out:
            taken.append(Said(waiting[0].at_ns, ERR, f"({self._left_out} lines are left out here: there are too many)"))
            self._left_out = 0
        room = MOST_BYTES
        while waiting and len(taken) < MOST_LINES and (room := room - _size(waiting[0])) >= 0:
            taken.append(self._pop())
        return tuple(taken)

    def _drop(self) -> None:
        self._pop()
        self._left_out += 1

    def _pop(self) -> Said:
        line = self._waiting.popleft()
        self._bytes -= _size(line)
        return line


def _size(line: Said) -> int:
    return _HEAD_BYTES + len(line.text.encode())
