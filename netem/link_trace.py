"""Recorded links: what a link does to its packets was measured, and stands in rows.

By packet, the n-th packet of the link takes the n-th row. By time, a packet takes the row in force when it enters the
link: the last one at or before that time. Behind the last row the rows begin again (`loop`), or the link is down.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

from netem.condition import Condition, Link
from netem.draws import uniform

OFFSET = "trace offset"  # purpose of draws
TRY = 1 << 40  # what one more try of a modem adds to a packet's number, which is below it
DOWN = Condition(up=False)


@dataclass(frozen=True, slots=True)
class LinkTrace:
    """The rows of a link, one condition each."""

    conditions: tuple[Condition, ...]
    times_ns: tuple[int, ...] = ()  # when each row begins, from 0 on, never earlier than the row before; () by packet
    period_ns: int = 0  # when the last row ends; 0 by packet
    loop: bool = False
    offset: bool = False  # whether it begins at a place that is drawn, for each link another

    @property
    def by_packet(self) -> bool:
        return not self.times_ns

    def shares(self) -> list[float]:
        """The share of each row: of the packets, or of the time."""
        if self.by_packet:
            return [1.0 / len(self.conditions)] * len(self.conditions)
        ends = [*self.times_ns[1:], self.period_ns]
        return [(end - begin) / self.period_ns for begin, end in zip(self.times_ns, ends, strict=True)]


class TraceProcess:
    """The rows of one link in use; nothing is remembered from packet to packet."""

    def __init__(self, seed: int, trace: LinkTrace, link: Link) -> None:
        self._trace = trace
        self._length = len(trace.conditions) if trace.by_packet else trace.period_ns
        self._offset = int(uniform(seed, OFFSET, *link) * self._length) if trace.offset else 0

    def condition(self, at_ns: int, seq: int) -> Condition:
        """The condition for packet `seq` of the link, which enters it at a time. All tries of a packet take one row."""
        trace = self._trace
        place = (seq % TRY if trace.by_packet else at_ns) + self._offset
        if place >= self._length:
            if not trace.loop:
                return DOWN
            place %= self._length
        return trace.conditions[place if trace.by_packet else bisect_right(trace.times_ns, place) - 1]
