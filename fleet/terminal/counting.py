"""Progress of work that is counted in runs or files."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console as Terminal

from fleet.terminal.status_line import PLAIN_S, REFRESH_S, StatusLine


class Counting:
    """Progress of something that goes through sim time; call it with where it is and where it ends [s]."""

    def __init__(self, terminal: Terminal, doing: str, *, quiet: bool = False) -> None:
        self._doing = doing
        self._line = StatusLine(terminal, quiet=quiet, first_s=REFRESH_S if terminal.is_terminal else PLAIN_S)

    def __enter__(self) -> Counting:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._line.__exit__(kind, error, trace)

    def __call__(self, at_s: float, end_s: float | None = None) -> None:
        """Say so if it is time to."""
        if self._line.due():
            whole = "" if end_s is None else f" / {end_s:g}"
            self._line.show(f"{self._doing} t = {at_s:.1f}{whole} s")
