"""The medium of the payloads of a run: a link of its own for each pair, or water that all share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from netem.causes import Cause
from netem.condition import Link
from netem.config import NetemConfig
from netem.faults import ActiveFaults
from netem.links import Links
from netem.transit import PendingPacket, Transit
from netem.vehicle_clock import Clocks
from netem.wire.messages import Fate

Place = tuple[float, ...]  # x, y, z [m, NED]


class MediumRound(NamedTuple):
    """The input of a medium for one round."""

    tick: int  # the round tick k
    until: int  # the next round tick
    transmissions: Mapping[int, tuple[bytes, ...]]  # payloads by sender
    positions: Mapping[int, Place] | None  # of everyone alive; None: unknown
    faults: ActiveFaults  # at the round tick
    clocks: Clocks | None = None  # None: all are right


class Medium(Protocol):
    """Turns the payloads of a round into packets and losses in a `Transit`."""

    def carry(self, round_: MediumRound) -> None:
        """Take the payloads of a round.

        Raises:
            ValueError: the medium needs positions, and there are none.
        """

    def close(self, end_tick: int) -> None:
        """Hand over everything that the medium still holds when the run ends."""

    def state(self) -> dict[str, Any]:
        """Everything of its own that determines the rest of the run, as plain values."""

    def restore(self, values: dict[str, Any]) -> None:
        """The inverse of `state`."""


class IndependentLinks:
    """Every directed link carries its payloads without regard to the others; what it does is decided on entry."""

    def __init__(self, config: NetemConfig, links: Links, transit: Transit) -> None:
        self._config = config
        self._links = links
        self._transit = transit

    def carry(self, round_: MediumRound) -> None:
        """Let every payload into all links of its sender."""
        for src in sorted(round_.transmissions):
            for payload in round_.transmissions[src]:
                for dst in self._links.receivers[src]:
                    self._enter(round_.tick, (src, dst), payload, round_.faults)

    def _enter(self, tick: int, link: Link, payload: bytes, faults: ActiveFaults) -> None:
        config, links, (src, dst) = self._config, self._links, link
        seq = links.number(link)
        cut = Cause.MUTE if src in faults.mute else faults.cut.get(link)
        if cut is not None:
            links.ledger.enter(link, sent=1)
            self._transit.lose(Fate(tick, src, dst, seq, 0, tick, tick, 0, cut, False, payload))
            return
        outcomes = links.enter(tick * config.tick_ns, link, seq, payload, faults)
        links.ledger.enter(link, sent=1, duplicated=len(outcomes) - 1)
        for copy, outcome in enumerate(outcomes):
            ticks = -(-outcome.delay_ns // config.tick_ns) + faults.slow.get(src, 0)
            due = tick + (ticks if config.ideal else max(1, ticks))
            packet = PendingPacket(due, tick, src, seq, copy, dst, outcome.delay_ns, outcome.payload, outcome.corrupted)
            if outcome.cause is not None:
                self._transit.lose(packet.fate(tick, outcome.cause))
            else:
                self._transit.add(packet)

    def close(self, end_tick: int) -> None:
        """Links hold nothing back."""

    def state(self) -> dict[str, Any]:
        """Nothing beyond the state of the links, which the network writes."""
        return {}

    def restore(self, values: dict[str, Any]) -> None:
        """The inverse of `state`."""
