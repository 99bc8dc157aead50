"""The last packets of every link, to tell which message made the difference to a vehicle.

Only messages of the protocol that a check judges count. Which these are is told by the signals that the check looks at:

| signals | messages |
|---|---|
| `control` | those of the agent's own protocol (all kinds but state messages); if it sends none, state messages |
| `guidance`, `error` | state messages, by which the formation is kept |
| all others | none: a depth or a force is not judged by what was heard |
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from fleet.logs.payload_kinds import STATE, kind_of
from fleet.result.verdict import LastMessage
from netem.causes import Cause
from netem.condition import Link
from netem.wire.messages import Fate


class LastMessages:
    """For each link and protocol: the last fate, and the sending time of the newest message that arrived whole."""

    def __init__(self, links: Sequence[Link], tick_ns: int) -> None:
        self._states, self._own = _LastOfLinks(links, tick_ns / 1e9), _LastOfLinks(links, tick_ns / 1e9)

    def settle(self, fate: Fate) -> None:
        """Take a final fate."""
        (self._states if kind_of(fate.payload) == STATE else self._own).settle(fate)

    def of(self, vehicles: Collection[int], signals: Iterable[str]) -> LastMessage | None:
        """The message that made the difference to some vehicles.

        Take the links whose last packet was lost. Among them it is the last packet of the link with the longest time
        since an arrival. If no last packet was lost, it is the packet that arrived last.

        Args:
            vehicles: that failed the check.
            signals: that the check looks at, such as `control.leads` or `|error.e|`.

        Returns:
            None if the check judges no protocol, or no packet of it has had a fate yet.
        """
        groups = {signal.lstrip("| ").partition(".")[0] for signal in signals}
        if "control" in groups:
            return (self._own if self._own.any else self._states).of(vehicles)
        return self._states.of(vehicles) if groups & {"guidance", "error"} else None


class _LastOfLinks:
    """The last fates of the messages of one protocol."""

    def __init__(self, links: Sequence[Link], tick_s: float) -> None:
        self._tick_s = tick_s
        self._into: dict[int, list[int]] = {}
        for src, dst in links:
            self._into.setdefault(dst, []).append(src)
        self._last: dict[Link, Fate] = {}
        self._heard: dict[Link, int] = {}  # tick of sending

    @property
    def any(self) -> bool:
        """Whether there was one."""
        return bool(self._last)

    def settle(self, fate: Fate) -> None:
        link = fate.src, fate.dst
        self._last[link] = fate
        if fate.cause == Cause.DELIVERED and not fate.corrupted:
            self._heard[link] = max(fate.sent_tick, self._heard.get(link, 0))

    def of(self, vehicles: Collection[int]) -> LastMessage | None:
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
