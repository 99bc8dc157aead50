"""What is seen while the report is made."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console as Terminal
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from fleet.reproduce.run import Tell

PLAIN_S = 5.0


@contextmanager
def showing(terminal: Terminal) -> Iterator[Tell]:
    """A bar on a terminal, a line now and then elsewhere."""
    if not terminal.is_terminal:
        last = [time.monotonic()]

        def line(text: str, share: float) -> None:
            if time.monotonic() - last[0] >= PLAIN_S:
                last[0] = time.monotonic()
                terminal.print(f"{share:4.0%}  {text}", highlight=False)

        yield line
        return
    columns = (TimeElapsedColumn(), BarColumn(24), TextColumn("{task.description}"))
    with Progress(*columns, console=terminal, transient=True) as progress:
        task = progress.add_task("starting", total=1.0)
        yield lambda text, share: progress.update(task, completed=share, description=text)
