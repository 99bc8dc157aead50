"""Progress of work that takes a while, on stderr: of a share, of simulated time, or of several jobs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from itertools import count
from typing import TYPE_CHECKING

from fleet.terminal.line import Piece, shortened
from fleet.terminal.status_line import BAR, PLAIN_S, REFRESH_S, StatusLine, bar, rewritable, stderr

if TYPE_CHECKING:
    from rich.console import Console as Terminal

FIRST_S = 2.0  # work that is done by then shows nothing


@contextmanager
def showing(doing: str, *, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A function to call with the share done (0..1), as often as you like."""
    with StatusLine(quiet=quiet, first_s=FIRST_S) as line:
        yield lambda share: line.update(lambda: [_name_piece(doing), Piece(0, [f"{100 * share:.0f} %"])])


@contextmanager
def showing_steps(doing: str) -> Iterator[Callable[[], None]]:
    """A function to call at each step of work of unknown length; only a terminal shows it."""
    terminal, steps = stderr(), count(1)
    with StatusLine(terminal, quiet=not rewritable(terminal), first_s=FIRST_S) as line:

        def report() -> None:
            step = next(steps)
            line.update(lambda: [_name_piece(doing), Piece(0, [f"step {step}"])])

        yield report


@contextmanager
def showing_time(doing: str) -> Iterator[Callable[[float, float], None]]:
    """A function to call with the simulated time reached and the time at which the work ends [s]."""
    terminal = stderr()
    with StatusLine(terminal, quiet=False, first_s=REFRESH_S if rewritable(terminal) else PLAIN_S) as line:
        yield lambda at_s, end_s: line.update(lambda: f"{doing} t = {at_s:.1f} / {end_s:g} s")


def _name_piece(doing: str) -> Piece:
    return Piece(1, [doing, *shortened(doing, 40, 20)])


@contextmanager
def showing_jobs(terminal: Terminal | None = None) -> Iterator[Callable[[str, float], None]]:
    """A function to call with what is being done and the share of everything that is done (0..1)."""
    began = time.monotonic()
    with StatusLine(terminal, quiet=False) as line:

        def report(doing: str, share: float) -> None:
            if line.due():
                elapsed = timedelta(seconds=int(time.monotonic() - began))
                drawn = Piece(2, [bar(share), bar(share, BAR // 2), f"{share:.0%}"])
                parts = [Piece(0, [str(elapsed)]), drawn, Piece(1, [doing, *shortened(doing, 40, 30, 20)])]
                line.show(parts if line.live else f"{share:4.0%}  {doing}")

        yield report
