"""What programs print, line by line."""

from __future__ import annotations

import fcntl
import os

MOST_LINE = 1 << 16  # characters of a line without a break


class ProgramOutput:
    """What a program writes to one of its standard outputs: a file in memory, so that it never waits for a reader."""

    def __init__(self) -> None:
        self.file = os.memfd_create("output")
        os.set_inheritable(self.file, False)
        fcntl.fcntl(self.file, fcntl.F_SETFL, os.O_APPEND)
        self._at, self._rest = 0, b""

    def lines(self, whole: bool) -> list[str]:
        """The lines that are complete; `whole`: what is left, too."""
        if self.file < 0:
            return []
        if not os.fstat(self.file).st_size and not (whole and self._rest):
            return []  # as in most turns
        parts = [self._rest]
        while data := os.pread(self.file, 1 << 20, self._at):
            parts.append(data)
            self._at += len(data)
        if self._at:  # no process of the program runs now, and all of them append
            os.ftruncate(self.file, 0)
            self._at = 0
        if len(parts) == 1 and not (whole and self._rest):
            return []
        lines = b"".join(parts).split(b"\n")
        self._rest = lines.pop()
        if (whole and self._rest) or len(self._rest) > MOST_LINE:
            lines.append(self._rest)
            self._rest = b""
        return [line.decode("utf-8", "replace").rstrip("\r") for line in lines]

    def close(self) -> None:
        """Forget what is left."""
        if self.file >= 0:
            os.close(self.file)
            self.file = -1
