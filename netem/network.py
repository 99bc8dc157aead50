"""The network core: payloads in at a round tick, inboxes out, one final fate per packet.

Pure: no clock, no I/O, no generator. A packet sent at round tick k with delay d is usable at
`max(k + 1, k + ceil(d / Ts))`: the least latency is one tick. Link conditions act on entry, so a due tick
never changes afterwards. On an ideal network (`NetemConfig.ideal`) a packet is due in its own sending tick.
"""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct

from netem.acoustic import AcousticChannel
from netem.condition import Condition, Link, condition_from_values, condition_values
from netem.config import NetemConfig
from netem.faults import NetFault, active_faults, fault_from_values, fault_values
from netem.impairment import LinkMemory, LinkModel
from netem.medium import IndependentLinks, Medium, MediumRound, Place, make_links
from netem.transit import HeldPacket, PendingPacket, Transit
from netem.vehicle_clock import Clocks
from netem.wire.messages import Delivery, Fate, MeasuredRange

# The order of packet records in the log.
fate_order = attrgetter("final_tick", "src", "dst", "seq", "copy")


class Exchange(NamedTuple):
    """The outcome of a round: what each vehicle will receive, and what became final."""

    inboxes: dict[int, tuple[Delivery, ...]]
    fates: tuple[Fate, ...]


class _State(Struct, omit_defaults=True):
    """The fields that `Netem.state` writes, without the medium's part."""

    round: int
    faults: list[list[Any]]
    next_seq: list[tuple[int, int, int]]
    links: list[tuple[int, int, dict[str, Any], list[Any]]]
    pending: list[PendingPacket]
    announced: list[PendingPacket]
    unheard: list[Fate]
    ledger: list[tuple[int, int, dict[str, Any]]]
    ranges: list[tuple[tuple[int, int, int, int], MeasuredRange]] = []
    held: list[HeldPacket] = []
    radios: list[tuple[int, list[Any]]] = []


class Netem:
    def __init__(self, config: NetemConfig) -> None:
        self.config = config
        self._clocks: Clocks | None = None
        self.faults = config.faults  # in the order in which they begin; replaced as a whole by who injects
        self._links = make_links(config)
        self._transit = Transit(config)
        make = IndependentLinks if config.acoustic is None else AcousticChannel
        self._medium: Medium = make(config, self._links, self._transit)
        self._round = -1

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
        self._medium.carry(MediumRound(tick, until, transmissions, positions, faults, self._clocks))
        if transit.held:
            # As all faults, a hold ends with the first round behind its end. If it ended within a round, a run in which
            # it was healed, which nobody knows before, would not be that of its record.
            transit.release(self.faults, tick, tick if ideal else tick + 1)
        # On an ideal network today's packets are due today, so they are announced before they are settled.
        fates = [] if ideal else transit.settle(tick)
        inboxes, unheard = transit.announce(alive, until, faults, self._clocks)
        if ideal:
            fates = transit.settle(tick)
        transit.lost += unheard
        self._round = tick
        return Exchange(inboxes, self._book(fates))

    def close(self, end_tick: int) -> tuple[Fate, ...]:
        """The fates not yet reported when the run ends before tick `end_tick` is started."""
        self._medium.close(end_tick)
        return self._book(self._transit.close(end_tick))

    def set_condition(self, link: Link, condition: Condition) -> None:
        """Change a link from now on; what is on its way, and what the link remembers, stays."""
        self._links.models[link].condition = condition

    def condition(self, link: Link) -> Condition:
        return self._links.models[link].condition

    def _book(self, fates: list[Fate]) -> tuple[Fate, ...]:
        fates.sort(key=fate_order)
        self._links.ledger.settle(fates)
        return tuple(fates)

    def state(self) -> dict[str, Any]:
        """Everything that determines the rest of the run, as plain values."""
        links, transit = self._links, self._transit
        state = _State(
            self._round,
            [fault_values(fault) for fault in self.faults],
            [(src, dst, seq) for (src, dst), seq in sorted(links.next_seq.items())],
            [(*link, condition_values(m.condition), m.state.to_values()) for link, m in sorted(links.models.items())],
            [packet for i in sorted(transit.pending) for packet in sorted(transit.pending[i])],
            transit.announced,
            transit.lost,
            [(*link, account.to_values()) for link, account in links.ledger.accounts.items()],
            sorted(transit.ranges.items(), key=itemgetter(0)),
            [held for link in sorted(transit.held) for held in transit.held[link]],
            [(i, radio.state.to_values()) for i, radio in sorted(links.radios.items())],
        )
        values: dict[str, Any] = msgspec.to_builtins(state, builtin_types=(bytes,))
        return values | self._medium.state()

    def restore(self, values: dict[str, Any]) -> None:
        """The inverse of `state`, into a core built from the same configuration. Raises msgspec.ValidationError: they
        are no such values."""
        state, links, transit = msgspec.convert(values, _State), self._links, self._transit
        self._round = state.round
        self.faults = tuple(fault_from_values(fault) for fault in state.faults)
        links.next_seq = {(src, dst): seq for src, dst, seq in state.next_seq}
        for src, dst, condition, memory in state.links:
            link, restored = (src, dst), LinkMemory.from_values(memory)
            links.models[link] = LinkModel(condition_from_values(condition), self.config.seed, link, restored)
        for i, memory in state.radios:
            links.radios[i] = LinkModel(self.config.radios[i], self.config.seed, (i, 0), LinkMemory.from_values(memory))
        for src, dst, account in state.ledger:
            links.ledger.restore((src, dst), account)
        transit.pending = {i: [] for i in self.config.vehicles}
        for packet in state.pending:
            transit.pending[packet.dst].append(packet)  # sorted, and a sorted list is a heap
        transit.held = {}
        for held in state.held:
            transit.hold(held)
        transit.announced, transit.lost, transit.ranges = state.announced, state.unheard, dict(state.ranges)
        self._medium.restore(values)
