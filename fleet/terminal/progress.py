"""Progress of work that takes a while, on stderr: of a share, of simulated time, or of several jobs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console as Terminal

from fleet.terminal.fitting import Piece, shortened
from fleet.terminal.status_line import BAR, PLAIN_S, REFRESH_S, StatusLine, bar, rewritable

FIRST_S = 2.0  # work that is done by then shows nothing


@contextmanager
def showing(doing: str, *, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A function to call with the share done (0..1), as often as you like."""
    with StatusLine(Terminal(stderr=True), quiet=quiet, first_s=FIRST_S) as line:

        def report(share: float) -> None:
            if line.due():
                line.show([Piece(1, [doing, *shortened(doing, 40, 20)]), Piece(0, [f"{100 * share:.0f} %"])])

        yield report


@contextmanager
def showing_steps(doing: str) -> Iterator[Callable[[], None]]:
    """A function to call at each step of work of unknown length; only a terminal shows it."""
    steps = 0
    terminal = Terminal(stderr=True)
    with StatusLine(terminal, quiet=not rewritable(terminal), first_s=FIRST_S) as line:

        def report() -> None:
            nonlocal steps
            steps += 1
            if line.due():
                line.show([Piece(1, [doing, *shortened(doing, 40, 20)]), Piece(0, [f"step {steps}"])])

        yield report


@contextmanager
def showing_time(doing: str) -> Iterator[Callable[[float, float], None]]:
    """A function to call with the simulated time reached and the time at which the work ends [s]."""
    terminal = Terminal(stderr=True)
    with StatusLine(terminal, quiet=False, first_s=REFRESH_S if rewritable(terminal) else PLAIN_S) as line:

        def report(at_s: float, end_s: float) -> None:
            if line.due():
                line.show(f"{doing} t = {at_s:.1f} / {end_s:g} s")

        yield report


@contextmanager
def showing_jobs(terminal: Terminal) -> Iterator[Callable[[str, float], None]]:
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
