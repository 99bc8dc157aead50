"""The display of a run while it goes on: its time and speed, the formation error, packets and faults."""

from __future__ import annotations

import time
from collections.abc import Callable

from fleet.recorder.journal import Journal
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.fault_entry import DIVERGED, TUMBLED
from fleet.terminal.line import GAP, Piece, shortened
from fleet.terminal.status_line import BAR, StatusLine, bar

STILL_S = 60.0  # between plain lines when nothing moves
MOST_FAULTS = 4  # shown by name


class ProgressLine:
    """Shows how a run goes on a status line; call it as often as you like."""

    def __init__(self, scenario: Scenario, journal: Journal, line: StatusLine, waiting: Callable[[], str]) -> None:
        """Prepare it; `waiting` says in words who is waited for and why, or nothing while the run moves."""
        self._journal, self._waiting, self._line = journal, waiting, line
        self._tick_s = scenario.tick_ns / 1e9
        self._ticks = scenario.ticks
        self._end_s = scenario.ticks * self._tick_s
        self._nodes, self._endless = bool(scenario.nodes), not scenario.ends
        self._moored = bool(scenario.spec.moored)
        self._began_s: float | None = None
        self._shown, self._still_until_s = (-1, ""), 0.0  # what the last plain line was about

    def __call__(self) -> None:
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
        self._line.show(self._pieces(now - self._began_s, waiting))

    def _pieces(self, passed_s: float, waiting: str) -> list[Piece]:
        tick, begin = max(0, self._journal.written), self._journal.begin
        at_s = tick * self._tick_s
        speed = f"{(tick - begin) * self._tick_s / passed_s:.1f} x" if passed_s else ""
        share = (tick - begin) / max(1, self._ticks - begin)
        off = self._journal.metrics.formation
        of_fleet = off.vehicles > 1
        whose = [f" (UUV {off.vehicle})", ""] if of_fleet else [""]
        worst_m, median_m = off.worst_m or 0.0, off.median_m or 0.0
        errors = [f"error {worst_m:.3f} m{of}" for of in whose]
        waits = waiting.replace("waiting for", "waits for")
        if self._nodes:
            progress = [f"t = {at_s:.1f} s"] if self._endless else [f"t = {at_s:.1f} / {self._end_s:g} s"]
            own = [Piece(0, progress), Piece(6, [*self._packets(), ""]), Piece(1, self._faults())]
            return [*own, Piece(3, [waiting, *shortened(waiting, 40, 30)])]
        return [
            Piece(0, [f"t = {at_s:.1f} / {self._end_s:g} s", f"{at_s:.1f}/{self._end_s:g} s"]),
            Piece(7, [bar(share), bar(share, BAR // 2), ""] if self._line.live else [""]),
            Piece(5, [f"{speed} real time", speed, ""] if speed else [""]),
            Piece(2, [""] if self._moored else [f"formation {errors[0]}", *errors, f"error {worst_m:.2f} m"]),
            Piece(8, [f"median {median_m:.3f} m", ""] if of_fleet and not self._moored else [""]),
            Piece(6, [*self._packets(), ""]),
            Piece(1, self._faults()),
            Piece(4, self._events()),
            Piece(3, [waiting, *shortened(waiting, 40, 30), *shortened(waits, 22)]),
        ]

    def _packets(self) -> list[str]:
        total = self._journal.ledger.total()
        lost = sum(total.lost.values()) - total.replaced
        never_sent = f", {total.replaced} replaced" if total.replaced else ""
        short = f"{total.delivered} delivered, {lost} lost"
        return [f"packets {short}{never_sent}", short]

    def _faults(self) -> list[str]:
        names = self._journal.active
        if not names:
            return [""]
        forms = []
        for most in range(MOST_FAULTS, 0, -1):
            more = f" and {len(names) - most} more" if len(names) > most else ""
            forms.append(f"faults {', '.join(names[:most])}{more}")
        return [*dict.fromkeys(forms), f"{len(names)} fault{'s' * (len(names) > 1)}"]

    def _events(self) -> list[str]:
        kinds = [(TUMBLED, sorted(self._journal.tumbled)), (DIVERGED, sorted(self._journal.diverged))]
        known = [(kind, vehicles) for kind, vehicles in kinds if vehicles]
        by_number = GAP.join(f"{kind} {', '.join(map(str, vehicles))}" for kind, vehicles in known)
        counted = GAP.join(f"{len(vehicles)} {kind}" for kind, vehicles in known)
        few = all(len(vehicles) <= MOST_FAULTS for _, vehicles in known)
        return [*([by_number] if few else []), counted, ""]
