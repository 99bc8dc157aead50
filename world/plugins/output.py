"""Where the lines go that a plug-in prints on purpose, such as a program of somebody else."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

MOST_BYTES = 16 * 2**20  # of one plug-in: what it prints besides is dropped, so that it never fills the disk
WriteLine = Callable[[str], None]
_place: ContextVar[Path | None] = ContextVar("place", default=None)
_STANDARD_ERROR = Path("-")


@contextmanager
def lines_go_into(folder: Path | None) -> Iterator[None]:
    """Write the lines of plug-ins that are made inside into files of a folder.

    Args:
        folder: it has a file for each, `agent-3.log`; None: standard error, which in a process of its own is its log.
    """
    token = _place.set(_STANDARD_ERROR if folder is None else folder)
    try:
        yield
    finally:
        _place.reset(token)


def line_writer(name: str) -> WriteLine:
    """What writes a line of a plug-in; by default, as in the runs of a study, it is dropped. `name`: of the file."""
    place = _place.get()
    if place is None:
        return lambda _: None
    left = MOST_BYTES

    def write(line: str) -> None:
        nonlocal left
        text = f"{line}\n"
        if left <= 0:
            return
        left -= len(text)
        if left <= 0:
            text += f"what it prints after {MOST_BYTES} bytes is left out\n"
        try:
            if place is _STANDARD_ERROR:
                sys.stderr.write(text)
            else:
                with (place / name).open("a", encoding="utf-8", errors="replace") as file:
                    file.write(text)
        except OSError:  # a full disk ends the lines, and no run
            left = 0

    return write
