"""Standard output and standard error of the command line, wherever they lead.

stdout is data: a failed write there (a full disk, a pipe without a reader, a closed descriptor) raises `OutputError`.
stderr is messages: a failed write there is ignored, and the work goes on.
"""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TextIO

_WORDS = {errno.EBADF: "it is closed", errno.EPIPE: "its reader is gone"}


class OutputError(Exception):
    """A failed write to standard output; only the command line handles it, so it is no FleetError."""

    status = 3

    def __init__(self, error: OSError) -> None:
        super().__init__(f"cannot write to standard output: {_WORDS.get(error.errno or 0, error.strerror)}")
        self.reader_gone = error.errno == errno.EPIPE


class _Data(io.FileIO):
    def write(self, data) -> int | None:  # type: ignore[no-untyped-def,override]  # a buffer, which 3.11 cannot name
        try:
            return super().write(data)
        except OSError as error:
            raise OutputError(error) from error


class _Messages(io.FileIO):
    def write(self, data) -> int | None:  # type: ignore[no-untyped-def,override]
        try:
            return super().write(data)
        except OSError:
            return len(data)


def open_streams() -> None:
    """Replace stdin, stdout and stderr by streams that exist, and that fail as this module says."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # It takes the lowest number, which the log of a run would get otherwise. Writing to stdout stays an error.
            os.open(os.devnull, os.O_WRONLY if descriptor == 2 else os.O_RDONLY)
            os.set_inheritable(descriptor, True)
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8")  # noqa: SIM115 - for as long as we live
    sys.stdout = _stream(_Data(1, "w", closefd=False), sys.stdout)
    sys.stderr = _stream(_Messages(2, "w", closefd=False), sys.stderr)


def _stream(raw: io.FileIO, before: TextIO | None) -> TextIO:
    """A text stream as Python makes it, on our raw layer."""
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding="utf-8" if before is None else before.encoding,
        errors="backslashreplace" if before is None else before.errors,
        line_buffering=raw.fileno() == 2 or raw.isatty(),
        write_through=isinstance(before, io.TextIOWrapper) and before.write_through,
    )


def give_up_output() -> None:
    """Discard everything for stdout from now on, also what is in its buffer."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.close(null)
