"""One line that shows how the work goes: rewritten in place on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from types import TracebackType
from typing import TYPE_CHECKING

from fleet.errors import harmless, printable
from fleet.terminal.line import Piece, fit

if TYPE_CHECKING:
    from rich.console import Console as Terminal

REFRESH_S = 0.1
PLAIN_S = 5.0
BAR = 24  # characters
_hushed: ContextVar[bool] = ContextVar("hushed", default=False)


@contextmanager
def hush_progress() -> Iterator[None]:
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
        self._began = time.monotonic()
        self._next = self._began + ((0.0 if self.live else PLAIN_S) if first_s is None else first_s)
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
            # Seldom where it takes long: a file of an hour's work would have 720 lines.
            self._next = at + max(PLAIN_S, (at - self._began) / 10)
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
