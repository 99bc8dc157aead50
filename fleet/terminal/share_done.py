"""Which share of something is done, on stderr: nothing for a while, then a line, rewritten in place on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console as Terminal

from fleet.terminal.status_line import StatusLine

FIRST_S = 2.0  # what is done by then says nothing


@contextmanager
def showing(doing: str, *, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A function that is told the share done, as often as one likes."""
    with StatusLine(Terminal(stderr=True), quiet=quiet, first_s=FIRST_S) as line:

        def tell(share: float) -> None:
            if line.due():
                line.show(f"{doing}: {100 * share:.0f} %")

        yield tell
