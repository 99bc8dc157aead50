"""What is seen while a run goes on: a progress line on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType

from rich.console import Console as Terminal
from rich.progress import BarColumn, Progress, TextColumn

from fleet.recorder.journal import Journal
from fleet.scenario.scenario import Scenario
from fleet.terminal.status_line import PLAIN_S, REFRESH_S

STILL_S = 60.0  # between lines when nothing moves
MOST_FAULTS = 4  # shown by name


class ProgressLine:
    """Sim time, speed, formation error, link counts and what faults there are; call it as often as you like."""

    def __init__(
        self,
        scenario: Scenario,
        journal: Journal,
        terminal: Terminal,
        *,
        quiet: bool,
        waiting: Callable[[], str],
    ) -> None:
        self._journal, self._waiting = journal, waiting
        self._tick_s = scenario.tick_ns / 1e9
        self._end_s = scenario.ticks * self._tick_s
        self._terminal, self._quiet = terminal, quiet
        self._live = terminal.is_terminal and not quiet
        self._every = REFRESH_S if self._live else PLAIN_S
        self._began: float | None = None
        self._next = 0.0
        self._told, self._still = (-1, ""), 0.0  # what was said last, and until when it need not be said again
        self._progress = Progress(
            TextColumn("{task.fields[time]}"),
            BarColumn(24),
            TextColumn("{task.fields[text]}"),
            console=terminal,
            transient=True,
            auto_refresh=False,
            disable=not self._live,
        )
        self._task = self._progress.add_task("", total=self._end_s, text="starting", time="")

    def __enter__(self) -> ProgressLine:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def __call__(self) -> None:
        """Redraw if it is time to."""
        if self._quiet:
            return
        now = time.monotonic()
        if self._began is None:
            self._next = now + self._every
        if self._began is None or self._journal.written < 0:
            self._began = now  # waiting for somebody to join is no part of the run
        if now < self._next:
            return
        self._next = now + self._every
        waiting = self._waiting()
        told = self._journal.written, waiting.rsplit(", ", 1)[0]  # without for how long
        if not self._live and told == self._told and now < self._still:
            return
        self._told, self._still = told, now + STILL_S
        sim_s = max(0, self._journal.written) * self._tick_s
        clock = f"t = {sim_s:.1f} / {self._end_s:g} s"
        text = f"{sim_s / max(1e-9, now - self._began):.1f} x real time  {self._state()}"
        if faults := self._journal.active:
            more = f" and {len(faults) - MOST_FAULTS} more" if len(faults) > MOST_FAULTS else ""
            text += f"  faults {', '.join(faults[:MOST_FAULTS])}{more}"
        if waiting:
            text += f"  {waiting}"
        if self._live:
            self._progress.update(self._task, completed=sim_s, text=text, time=clock)
            self._progress.refresh()
        else:
            self._terminal.print(f"{clock}  {text}", highlight=False, soft_wrap=True)

    def _state(self) -> str:
        total = self._journal.ledger.total()
        lost = sum(total.lost.values()) - total.replaced
        never_sent = f", {total.replaced} replaced" if total.replaced else ""
        return (
            f"formation error {self._journal.metrics.formation}  "
            f"packets {total.delivered} delivered, {lost} lost{never_sent}"
        )
