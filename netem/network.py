"""The network core: payloads in at a round tick, inboxes out, one final fate per packet.

Pure: no clock, no I/O, no generator. A packet sent at round tick k with delay d is usable at
`max(k + 1, k + ceil(d / Ts))`: the least latency is one tick. Link conditions act on entry, so a due tick
never changes afterwards. On an ideal network (`NetemConfig.ideal`) a packet is due in its own sending tick.
"""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from typing import NamedTuple

from netem.acoustic import AcousticChannel
from netem.condition import Link
from netem.config import NetemConfig
from netem.faults import NetFault, active_faults
from netem.links import make_links
from netem.lockstep_modems import LockstepModems
from netem.medium import IndependentLinks, Medium, MediumRound, Place
from netem.transit import PendingPacket, Transit
from netem.vehicle_clock import Clocks
from netem.wire.messages import Delivery, Fate

# The order of packet records in the log.
fate_order = attrgetter("final_tick", "src", "dst", "seq", "copy")


class Exchange(NamedTuple):
    """The outcome of a round: what each vehicle will receive, and what became final."""

    inboxes: dict[int, tuple[Delivery, ...]]
    fates: tuple[Fate, ...]


class Netem:
    def __init__(self, config: NetemConfig) -> None:
        self.config = config
        self._clocks: Clocks | None = None
        self.faults = config.faults  # in the order in which they begin; replaced as a whole by who injects
        self._links = make_links(config)
        self._transit = Transit(config)
        self._medium: Medium
        self._modems: LockstepModems | None = None
        if config.acoustic is None:
            self._medium = IndependentLinks(config, self._links, self._transit)
        else:
            self._medium = water = AcousticChannel(config, self._links, self._transit)
            self._modems = LockstepModems(config, water, self._transit)

    @property
    def faults(self) -> tuple[NetFault, ...]:
        """All faults, ordered by their begin. A caller that injects a fault replaces the whole list."""
        return self._faults

    @faults.setter
    def faults(self, faults: tuple[NetFault, ...]) -> None:
        self._faults = faults
        self._clocks = Clocks.that_differ(self.config.clocks, faults, self.config.tick_ns)

    @property
    def entered(self) -> dict[Link, tuple[int, int]]:
        """The number of packets sent into each link, and the number of duplicates that the link added."""
        return {link: (account.sent, account.duplicated) for link, account in self._links.ledger.accounts.items()}

    def exchange(
        self, tick: int, transmissions: Mapping[int, tuple[bytes, ...]], positions: Mapping[int, Place] | None = None
    ) -> Exchange:
        """One round: take the payloads sent at round tick `tick`, hand out what falls due until the next.

        Args:
            tick: the round tick k; rounds are exchanged in order.
            transmissions: payloads by sender. A sender's payload goes to every graph neighbour.
            positions: true x, y, z [m, NED] of everyone alive, who may be more than have transmitted; None: those.

        Returns:
            for every living vehicle all deliveries due in (k, k + m] in order (due, sent, src, seq, copy),
            and every fate that became final in (k - m, k].

        Raises:
            ValueError: an acoustic channel, and no positions.
        """
        faults, ideal, transit = active_faults(self.faults, tick), self.config.ideal, self._transit
        until = tick if ideal else tick + self.config.round_ticks
        alive = transmissions.keys() if positions is None else positions.keys()
        round_ = MediumRound(tick, until, transmissions, positions, faults, self._clocks)
        if self._modems is not None:
            transmitted, starts = self._modems.take(transmissions)
            round_ = round_._replace(transmissions=transmitted, starts=starts)
        self._medium.carry(round_)
        if transit.held:
            # As all faults, a hold ends with the first round behind its end. If it ended within a round, a run in which
            # it was healed, which is not known before, would not be that of its record.
            transit.release(self.faults, tick, tick if ideal else tick + 1)
        # On an ideal network today's packets are due today, so they are announced before they are settled.
        fates = [] if ideal else transit.settle(tick)
        before = len(transit.announced)
        inboxes, unheard = transit.announce(alive, until, faults, self._clocks)
        if self._modems is not None:
            self._modems.tell(tick, until, inboxes, transit.announced[before:], positions or {})
        if ideal:
            fates = transit.settle(tick)
        transit.lost += unheard
        return Exchange(inboxes, self._book(fates))

    def close(self, end_tick: int) -> tuple[Fate, ...]:
        """The fates not yet reported when the run ends before tick `end_tick` is started."""
        self._medium.close(end_tick)
        return self._book(self._transit.close(end_tick))

    def _book(self, fates: list[Fate]) -> tuple[Fate, ...]:
        fates.sort(key=fate_order)
        self._links.ledger.settle(fates)
        return tuple(fates)

    def settle(self, tick: int) -> tuple[Fate, ...]:
        """The fates up to a tick that are not yet reported, before the round behind it reports them."""
        return self._book(self._transit.settle(tick))

    def under_way(self) -> list[PendingPacket]:
        """The packets that will arrive and have no final fate yet."""
        return [*self._transit.announced, *(packet for queue in self._transit.pending.values() for packet in queue)]

    def take_over(self, before: Netem) -> None:
        """Go on at a round from the network of another run on the same graph. Conditions and faults are our own."""
        self._links.take_over(before._links)
        self._transit.take_over(before._transit)
        self._medium.take_over(before._medium)
        if self._modems is not None and before._modems is not None:
            self._modems.take_over(before._modems)
