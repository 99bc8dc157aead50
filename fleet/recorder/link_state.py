"""How a directed link is doing, by what became of its last packets."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from netem.causes import Cause

HISTORY = 10  # packets that count
LEAST_STALE_S = 1.0
STALE_ROUNDS = 5  # without an arrival, where that is longer
CUTS = frozenset({Cause.DOWN, Cause.PARTITION, Cause.MUTE, Cause.DEAF, Cause.DEAD_RECEIVER, Cause.DEAD_SENDER})

DELIVERED, LATE, LOST, DOWN, STALE, UNUSED = "delivered", "late", "lost", "down", "stale", "unused"
WORST_FIRST = (DOWN, STALE, LOST, LATE, DELIVERED, UNUSED)  # all states
# What became of one packet, as a page is told it.
ARRIVED, BEHIND, DAMAGED, GONE, CUT = "arrived", "late", "damaged", "lost", "cut"
LOSSES = frozenset({DAMAGED, GONE, CUT})


def fate_of(cause: str, delay_s: float, corrupted: bool, round_s: float) -> str:
    """What became of a packet: ARRIVED, BEHIND (after the next one was sent), DAMAGED, GONE or CUT (the link was).

    Args:
        cause: the field `fate` of its message.
        delay_s: from sending to the time at which it can be used [s].
        round_s: between two packets [s].
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
    """What is known of one link."""

    fates: deque[str] = field(default_factory=lambda: deque(maxlen=HISTORY))
    sent_s: float = 0.0  # when the newest that arrived was sent; nobody has heard of another at the start
    arrived_s: float = 0.0  # when something arrived last

    def settle(self, fate: str, sent_s: float, due_s: float) -> None:
        """Take one packet."""
        self.fates.append(fate)
        if fate in (ARRIVED, BEHIND):
            self.sent_s = max(self.sent_s, sent_s)
            self.arrived_s = max(self.arrived_s, due_s)

    def age_s(self, now_s: float) -> float:
        """How old the newest is that the receiver has [s]."""
        return max(0.0, now_s - self.sent_s)

    @property
    def lost_of_last(self) -> int:
        """How many of the last HISTORY packets did not arrive whole."""
        return sum(fate in LOSSES for fate in self.fates)

    def state(self, now_s: float, stale_s: float) -> str:
        """One of WORST_FIRST; the first that holds of: down, stale, lost, late, delivered.

        Args:
            stale_s: after so long without an arrival it is stale.
        """
        if not self.fates:
            return STALE if now_s > stale_s else UNUSED
        if self.fates[-1] == CUT:
            return DOWN
        if now_s - self.arrived_s > stale_s:
            return STALE
        if self.lost_of_last:
            return LOST
        return LATE if self.fates.count(BEHIND) > len(self.fates) // 2 else DELIVERED


def stale_after(round_s: float) -> float:
    """After how long without an arrival a link is stale [s]."""
    return max(LEAST_STALE_S, STALE_ROUNDS * round_s)
