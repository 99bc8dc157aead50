"""One line that shows how the work goes: rewritten in place on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import timedelta
from itertools import count
from types import TracebackType
from typing import TYPE_CHECKING

from fleet.errors import harmless, printable
from fleet.terminal.table import Piece, fit, shortened

if TYPE_CHECKING:
    from rich.console import Console as Terminal

REFRESH_S = 0.1
PLAIN_S = 5.0
BAR = 24  # characters
_hushed: ContextVar[bool] = ContextVar("hushed", default=False)


@contextmanager
def hushed() -> Iterator[None]:
    """Show no progress inside, whatever is done there."""
    token = _hushed.set(True)
    try:
        yield
    finally:
        _hushed.reset(token)


def stderr() -> Terminal:
    """Where progress is shown, and what is said beside a result."""
    from rich.console import Console as Terminal  # here, for commands start without it

    return Terminal(stderr=True)


def rewritable(terminal: Terminal) -> bool:
    """Whether a line can be written again in place. FORCE_COLOR (CI, Jupyter) asks for colours, in a file as well."""
    return terminal.is_terminal and (terminal.file.isatty() or not os.environ.get("FORCE_COLOR"))


class StatusLine:
    """Ask `due` as often as you like, and `show` something when it is."""

    def __init__(self, terminal: Terminal | None = None, *, quiet: bool, first_s: float | None = None) -> None:
        """Prepare it; nothing is shown yet.

        `terminal`: None: stderr. `quiet`: show nothing at all. `first_s`: how long nothing is shown at first; by
        default 0 on a terminal, a while elsewhere.
        """
        self._terminal, self._quiet = terminal or stderr(), quiet or _hushed.get()
        self.live = rewritable(self._terminal)
        self._next = time.monotonic() + ((0.0 if self.live else PLAIN_S) if first_s is None else first_s)
        self._shown = False

    def __enter__(self) -> StatusLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clear()

    def due(self) -> bool:
        """Whether it is time to show something."""
        return not self._quiet and time.monotonic() >= self._next

    def update(self, what: Callable[[], str | Sequence[Piece]]) -> None:
        """Show what a function gives, when it is time."""
        if self.due():
            self.show(what())

    def show(self, what: str | Sequence[Piece]) -> None:
        """Show a text, or as much of some pieces as fits, on a terminal in place of what was shown before."""
        at = time.monotonic()
        if self._quiet:
            return
        width = self._terminal.width - 1 if self.live else None
        text = printable(what if isinstance(what, str) else fit(what, width))
        if self.live:
            self._next = at + REFRESH_S
            self._terminal.file.write(f"\r{text[:width]}\x1b[K")
            self._terminal.file.flush()
            self._shown = True
        elif at >= self._next:
            self._next = at + PLAIN_S
            self._terminal.print(text, highlight=False, markup=False, soft_wrap=True)

    def print(self, text: str) -> None:
        """Print a line that stays."""
        if not self._quiet:
            self._clear()
            self._terminal.print(harmless(text), highlight=False, markup=False, soft_wrap=True)

    def _clear(self) -> None:
        if self._shown:
            self._terminal.file.write("\r\x1b[K")
            self._terminal.file.flush()
            self._shown = False


def bar(share: float, length: int = BAR) -> str:
    """A bar of this number of characters; a share in 0..1 of them is drawn heavily."""
    done = round(length * min(1.0, max(0.0, share)))
    return "\u2501" * done + "\u2500" * (length - done)


# --- progress
# Progress of work that takes a while, on stderr: of a share, of simulated time, or of several jobs.


FIRST_S = 2.0  # work that is done by then shows nothing


@contextmanager
def showing(doing: str, *, quiet: bool = False) -> Iterator[Callable[[float], None]]:
    """A function to call with the share done (0..1), as often as you like."""
    with StatusLine(quiet=quiet, first_s=FIRST_S) as line:
        yield lambda share: line.update(lambda: [_named(doing), Piece(0, [f"{100 * share:.0f} %"])])


@contextmanager
def showing_steps(doing: str) -> Iterator[Callable[[], None]]:
    """A function to call at each step of work of unknown length; only a terminal shows it."""
    terminal, steps = stderr(), count(1)
    with StatusLine(terminal, quiet=not rewritable(terminal), first_s=FIRST_S) as line:

        def report() -> None:
            step = next(steps)
            line.update(lambda: [_named(doing), Piece(0, [f"step {step}"])])

        yield report


@contextmanager
def showing_time(doing: str) -> Iterator[Callable[[float, float], None]]:
    """A function to call with the simulated time reached and the time at which the work ends [s]."""
    terminal = stderr()
    with StatusLine(terminal, quiet=False, first_s=REFRESH_S if rewritable(terminal) else PLAIN_S) as line:
        yield lambda at_s, end_s: line.update(lambda: f"{doing} t = {at_s:.1f} / {end_s:g} s")


def _named(doing: str) -> Piece:
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
