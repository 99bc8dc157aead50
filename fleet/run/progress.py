"""What a run shows while it goes on: where it is, how fast, the formation error, packets and faults."""

from __future__ import annotations

import time
from collections.abc import Callable

from fleet.recorder.journal import Journal
from fleet.scenario.scenario import Scenario
from fleet.terminal.status_line import StatusLine, bar

STILL_S = 60.0  # between plain lines when nothing moves
MOST_FAULTS = 4  # shown by name


class ProgressLine:
    """Shows how a run goes on a status line; call it as often as you like."""

    def __init__(self, scenario: Scenario, journal: Journal, line: StatusLine, waiting: Callable[[], str]) -> None:
        """Prepare it.

        Args:
            waiting: who waits for whom, in words; empty: the run moves.
        """
        self._journal, self._waiting, self._line = journal, waiting, line
        self._tick_s = scenario.tick_ns / 1e9
        self._end_s = scenario.ticks * self._tick_s
        self._began_s: float | None = None
        self._shown, self._still_until_s = (-1, ""), 0.0  # what the last plain line was about

    def __call__(self) -> None:
        """Show it if it is time to."""
        now = time.monotonic()
        if self._began_s is None or self._journal.written < 0:
            self._began_s = now  # waiting for agents to join is no part of the run
        if not self._line.due():
            return
        waiting = self._waiting()
        about = self._journal.written, waiting.rsplit(", ", 1)[0]  # without for how long
        if not self._line.live and about == self._shown and now < self._still_until_s:
            return
        self._shown, self._still_until_s = about, now + STILL_S
        sim_s = max(0, self._journal.written) * self._tick_s
        drawn = f" {bar(sim_s / self._end_s)} " if self._line.live else "  "
        text = f"{sim_s / max(1e-9, now - self._began_s):.1f} x real time  {self._state()}"
        if faults := self._journal.active:
            more = f" and {len(faults) - MOST_FAULTS} more" if len(faults) > MOST_FAULTS else ""
            text += f"  faults {', '.join(faults[:MOST_FAULTS])}{more}"
        if waiting:
            text += f"  {waiting}"
        self._line.show(f"t = {sim_s:.1f} / {self._end_s:g} s{drawn}{text}")

    def _state(self) -> str:
        total = self._journal.ledger.total()
        lost = sum(total.lost.values()) - total.replaced
        never_sent = f", {total.replaced} replaced" if total.replaced else ""
        return (
            f"formation error {self._journal.metrics.formation}  "
            f"packets {total.delivered} delivered, {lost} lost{never_sent}"
        )
