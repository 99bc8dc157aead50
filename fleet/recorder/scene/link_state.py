"""The state of a directed link, by what became of its last packets: one rule for the log, the page and the movie.

A packet leaves a mark in the history of its link: `+` arrived, `-` lost, `x` lost because the link was cut.
`state_of` gives the state of a history. A viewer that knows when packets arrived tells two states more, `stale` and
`late`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum

from netem.cause import Cause

HISTORY = 10  # packets that count
UNHEARD_OF = 5  # lost in a row: nothing arrives any more
LEAST_STALE_S = 1.0
STALE_ROUNDS = 5  # without an arrival, where that is longer
CUTS = frozenset({Cause.DOWN, Cause.PARTITION, Cause.MUTE, Cause.DEAF, Cause.DEAD_RECEIVER, Cause.DEAD_SENDER})


class LinkState(StrEnum):
    """How a link is doing; the worst first."""

    CUT = "cut"  # the last packet was lost since the link was cut, or five in a row were lost
    STALE = "stale"  # nothing has arrived for long
    LOSING = "losing"  # one of the last ten was lost
    LATE = "late"  # most packets arrived after the next packet had been sent
    DELIVERING = "delivering"
    SILENT = "silent"  # no packet yet


# What became of one packet, as a page is told it.
ARRIVED, BEHIND, DAMAGED, GONE, CUT = "arrived", "late", "damaged", "lost", "cut"
LOSSES = frozenset({DAMAGED, GONE, CUT})
_MARK_OF_FATE = {ARRIVED: "+", BEHIND: "+", DAMAGED: "-", GONE: "-", CUT: "x"}
_MARK_OF_CAUSE = {cause: "x" if cause in CUTS else "-" for cause in Cause} | {Cause.DELIVERED: "+", Cause.IN_FLIGHT: ""}


def mark_of(cause: Cause, *, corrupted: bool) -> str:
    """The mark of a packet; none while it is in flight."""
    mark = _MARK_OF_CAUSE[cause]
    return "-" if corrupted and mark == "+" else mark


def state_of(marks: str) -> LinkState:
    """The state of a link with these marks of its last packets, the newest last: SILENT, CUT, LOSING or DELIVERING."""
    if not marks:
        return LinkState.SILENT
    if marks[-1] == "x" or (len(marks) >= UNHEARD_OF and "+" not in marks[-UNHEARD_OF:]):
        return LinkState.CUT
    return LinkState.DELIVERING if set(marks) == {"+"} else LinkState.LOSING


def fate_of(cause: str, delay_s: float, corrupted: bool, round_s: float) -> str:
    """The fate of a packet: ARRIVED, BEHIND (after the next one was sent), DAMAGED, GONE or CUT (the link was). `cause`
    is the field `fate` of its message; the times [s] are those until it can be used, and between two packets.
    """
    if cause in CUTS:
        return CUT
    if cause != Cause.DELIVERED:
        return GONE
    if corrupted:
        return DAMAGED
    return BEHIND if delay_s > 1.001 * round_s else ARRIVED


@dataclass(slots=True)
class LinkHistory:
    """The present knowledge of one link."""

    fates: deque[str] = field(default_factory=lambda: deque(maxlen=HISTORY))
    sent_s: float | None = 0.0  # when the newest that arrived was sent, or the run began; None: it is not known
    arrived_s: float = 0.0  # when something arrived last

    def settle(self, fate: str, sent_s: float, due_s: float) -> None:
        self.fates.append(fate)
        if fate in (ARRIVED, BEHIND):
            self.sent_s = max(self.sent_s or 0.0, sent_s)
            self.arrived_s = max(self.arrived_s, due_s)

    def mark_sent(self, sent_s: float) -> None:
        """Take from somebody who knows the whole run when the newest that arrived was sent."""
        if self.sent_s is None:
            self.arrived_s = sent_s
        self.sent_s = max(self.sent_s or 0.0, sent_s)

    def age_s(self, now_s: float) -> float | None:
        """How old the newest is that the receiver has [s]; None: it is not known."""
        return None if self.sent_s is None else max(0.0, now_s - self.sent_s)

    @property
    def lost_of_last(self) -> int:
        """How many of the last HISTORY packets did not arrive whole."""
        return sum(fate in LOSSES for fate in self.fates)

    def state(self, now_s: float, stale_s: float) -> LinkState:
        """The state, with what times tell: STALE after `stale_s` without an arrival, LATE where most come late."""
        state = state_of("".join(_MARK_OF_FATE[fate] for fate in self.fates))
        if state is LinkState.CUT:
            return state
        if now_s - self.arrived_s > stale_s:
            return LinkState.STALE
        mostly_late = self.fates.count(BEHIND) > len(self.fates) // 2
        return LinkState.LATE if state is LinkState.DELIVERING and mostly_late else state


def stale_after(round_s: float) -> float:
    """After how long without an arrival a link is stale [s]."""
    return max(LEAST_STALE_S, STALE_ROUNDS * round_s)
