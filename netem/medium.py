"""The medium of the payloads of a run: a link of its own for each pair, or water that all share."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from netem.cause import Cause
from netem.condition import Link
from netem.config import NetemConfig
from netem.faults import ActiveFaults
from netem.links import Links
from netem.transit import HeldPacket, PendingPacket, Transit
from netem.vehicle_clock import Clocks
from netem.wire.messages import Fate

Place = tuple[float, ...]  # x, y, z [m, NED]


class MediumRound(NamedTuple):
    """The input of a medium for one round."""

    tick: int  # the round tick k
    until: int  # the next round tick
    transmissions: Mapping[int, tuple[bytes, ...]]  # payloads by sender
    positions: Mapping[int, Place] | None  # places of everyone alive; None: unknown
    faults: ActiveFaults  # the faults at the round tick
    clocks: Clocks | None = None  # None: all are right
    starts: Mapping[tuple[int, int], int] = MappingProxyType({})  # start ticks that are asked for, by (sender, number)


class Medium(Protocol):
    """Turns the payloads of a round into packets and losses in a `Transit`."""

    def carry(self, round_: MediumRound) -> None:
        """Take the payloads of a round. Raises ValueError: the medium needs positions, and there are none."""

    def close(self, end_tick: int) -> None:
        """Hand over everything that the medium still holds when the run ends."""

    def take_over(self, before: Any) -> None:
        """Go on from the medium of another run on the same graph, which is of the same kind."""


class IndependentLinks:
    """Every directed link carries its payloads without regard to the others; what it does is decided on entry."""

    def __init__(self, config: NetemConfig, links: Links, transit: Transit) -> None:
        self._config = config
        self._links = links
        self._transit = transit

    def carry(self, round_: MediumRound) -> None:
        for src in sorted(round_.transmissions):
            for payload in round_.transmissions[src]:
                for dst in self._links.receivers[src]:
                    self.enter(round_.tick, (src, dst), payload, round_.faults)

    def enter(self, tick: int, link: Link, payload: bytes, faults: ActiveFaults) -> None:
        """Send one packet into a link at a tick."""
        config, links, (src, dst) = self._config, self._links, link
        seq = links.number(link)
        cut = Cause.MUTE if src in faults.mute else faults.cut.get(link)
        if cut is not None:
            links.ledger.enter(link, sent=1)
            self._transit.lose(Fate(tick, src, dst, seq, 0, tick, tick, 0, cut, False, payload))
            return
        at_ns, radio = tick * config.tick_ns, links.radios.get(src)
        if radio is None:
            outcomes = links.enter(at_ns, link, seq, payload, faults)
        else:
            outcomes = links.transmit(radio, at_ns, link, seq, payload, faults)
        ours = len(outcomes)  # beside them is the copy that a fault adds
        if link in faults.again and outcomes[0].cause is None:
            later_ns = faults.again[link] * config.tick_ns
            outcomes = [*outcomes, outcomes[0]._replace(delay_ns=outcomes[0].delay_ns + later_ns)]
        links.ledger.enter(link, sent=1, duplicated=len(outcomes) - 1)
        for copy, outcome in enumerate(outcomes):
            ticks = -(-outcome.delay_ns // config.tick_ns) + faults.slow.get(src, 0)
            due = tick + (ticks if config.ideal else max(1, ticks))
            packet = PendingPacket(due, tick, src, seq, copy, dst, outcome.delay_ns, outcome.payload, outcome.corrupted)
            if outcome.cause is not None:
                self._transit.lose(packet.fate(tick, outcome.cause))
            elif link in faults.hold:
                self._transit.hold(HeldPacket(packet, faults.again[link] if copy >= ours else 0, faults.hold[link]))
            else:
                self._transit.add(packet)

    def close(self, end_tick: int) -> None:
        """Links hold nothing back."""

    def take_over(self, before: IndependentLinks) -> None:
        """Links remember nothing beyond what `Links` has."""
