"""The last packets of every link, to tell which message made the difference to a vehicle."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from fleet.checks.verdict import LastMessage
from netem.causes import Cause
from netem.condition import Link
from netem.wire.messages import Fate


class LastMessages:
    """Of each link the last fate, and when the newest that arrived whole was sent."""

    def __init__(self, links: Sequence[Link], tick_ns: int) -> None:
        self._tick_s = tick_ns / 1e9
        self._into: dict[int, list[int]] = {}
        for src, dst in links:
            self._into.setdefault(dst, []).append(src)
        self._last: dict[Link, Fate] = {}
        self._heard: dict[Link, int] = {}  # tick of sending

    def settle(self, fate: Fate) -> None:
        """Take a final fate."""
        link = fate.src, fate.dst
        self._last[link] = fate
        if fate.cause == Cause.DELIVERED and not fate.corrupted:
            self._heard[link] = max(fate.sent_tick, self._heard.get(link, 0))

    def of(self, vehicles: Collection[int]) -> LastMessage | None:
        """The message that made the difference to some vehicles.

        Where the last packet of a link was lost: of those links the one on which nothing has arrived for longest, and
        that packet. Else the packet that arrived last. None: no packet has had a fate yet.
        """
        known = [(src, dst) for dst in vehicles for src in self._into.get(dst, ()) if (src, dst) in self._last]
        if not known:
            return None
        missed = [link for link in known if not self._arrived(self._last[link])]
        if missed:
            link = min(missed, key=lambda one: (self._heard.get(one, -1), one))
        else:
            link = max(known, key=lambda one: (self._last[one].final_tick, one))
        fate, heard = self._last[link], self._heard.get(link)
        how = "corrupted" if fate.cause == Cause.DELIVERED and fate.corrupted else str(fate.cause)
        return LastMessage(
            src=fate.src,
            dst=fate.dst,
            sent_s=fate.sent_tick * self._tick_s,
            at_s=fate.final_tick * self._tick_s,
            fate=how,
            heard_s=None if heard is None else heard * self._tick_s,
        )

    @staticmethod
    def _arrived(fate: Fate) -> bool:
        return fate.cause == Cause.DELIVERED and not fate.corrupted
