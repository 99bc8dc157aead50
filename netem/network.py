"""The network core: payloads in at a round tick, inboxes out, one final fate per packet.

Pure: no clock, no I/O, no generator. A packet sent at round tick k with delay d is usable at
`max(k + 1, k + ceil(d / Ts))`: the least latency is one tick. Link conditions act on entry, so a due tick
never changes afterwards. On an ideal network (`NetemConfig.ideal`) a packet is due in its own sending tick.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import replace as replaced
from typing import Any, NamedTuple

from msgspec.structs import astuple, replace

from netem.causes import DEAD_RECEIVER, DEAF, DELIVERED, IN_FLIGHT, MUTE
from netem.condition import Condition, Link, condition_from_values, condition_values
from netem.config import NetemConfig
from netem.faults import ActiveFaults, active_faults, fault_from_values, fault_values
from netem.impairment import LinkModel, LinkOutcome, LinkState
from netem.ledger import Ledger
from netem.wire.messages import Delivery, Fate

PERFECT = Condition()


class Packet(NamedTuple):
    """A payload under way; packets sort by the order in which their receiver sees them."""

    due_tick: int
    sent_tick: int
    src: int
    seq: int
    copy: int
    dst: int
    delay_ns: int
    payload: bytes
    corrupted: bool


class Exchange(NamedTuple):
    """The outcome of a round: what each vehicle will receive, and what became final."""

    inboxes: dict[int, tuple[Delivery, ...]]
    fates: tuple[Fate, ...]


class Netem:
    """The impaired network of one run."""

    def __init__(self, config: NetemConfig) -> None:
        self.config = config
        self._models = {
            link: LinkModel(config.conditions.get(link, PERFECT), config.seed, link) for link in config.links
        }
        self._receivers: dict[int, list[int]] = {i: [] for i in config.vehicles}
        for src, dst in sorted(config.links):
            self._receivers[src].append(dst)
        self._next_seq: dict[Link, int] = dict.fromkeys(config.links, 0)
        self._pending: dict[int, list[Packet]] = {i: [] for i in config.vehicles}  # not yet in an inbox
        self._announced: list[Packet] = []  # in an inbox, not yet due
        self._unheard: list[Fate] = []  # lost at a receiver that cannot hear, not yet due
        self._ledger = Ledger(config.links)
        self._round = -1
        self.faults = config.faults  # in the order in which they begin; replaced as a whole by who injects

    @property
    def entered(self) -> dict[Link, tuple[int, int]]:
        """Packets sent into each link so far, and those that it added as duplicates."""
        return {link: (account.sent, account.duplicated) for link, account in self._ledger.accounts.items()}

    def exchange(
        self,
        tick: int,
        transmissions: Mapping[int, tuple[bytes, ...]],
        positions: Mapping[int, tuple[float, ...]] | None = None,
    ) -> Exchange:
        """One round: take the payloads sent at round tick `tick`, hand out what falls due until the next.

        Args:
            tick: the round tick k; rounds are exchanged in order.
            transmissions: payloads by sender. A sender's payload goes to every graph neighbour.
            positions: true x, y, z [m, NED] of everyone alive, who may be more than have transmitted; None: those.

        Returns:
            for every living vehicle all deliveries due in (k, k + m] in order (due, sent, src, seq, copy),
            and every fate that became final in (k - m, k].
        """
        config = self.config
        now = active_faults(self.faults, tick)
        dropped: list[Fate] = []
        for src in sorted(transmissions):
            for payload in transmissions[src]:
                for dst in self._receivers[src]:
                    dropped += self._enter(tick, src, dst, payload, now)
        alive: Mapping[int, Any] = transmissions if positions is None else positions
        until = tick if config.ideal else tick + config.round_ticks
        # On an ideal network today's packets are due today, so they are announced before they are settled.
        if config.ideal:
            inboxes, unheard = self._announce(alive, until, now)
            delivered = self._settle(tick)
        else:
            delivered = self._settle(tick)
            inboxes, unheard = self._announce(alive, until, now)
        self._unheard += unheard
        self._round = tick
        return Exchange(inboxes, self._book(dropped + delivered))

    def close(self, end_tick: int) -> tuple[Fate, ...]:
        """The fates not yet reported when the run ends before tick `end_tick` is started."""
        fates = self._settle(end_tick - 1)
        rest = self._announced + [p for i in sorted(self._pending) for p in self._pending[i]]
        fates += [_fate(packet, end_tick, IN_FLIGHT) for packet in rest]
        fates += [replace(fate, final_tick=end_tick, cause=IN_FLIGHT) for fate in self._unheard]
        self._unheard = []
        self._announced, self._pending = [], {i: [] for i in self._pending}
        return self._book(fates)

    def set_condition(self, link: Link, condition: Condition) -> None:
        """Change a link from now on; what is on its way, and what the link remembers, stays."""
        self._models[link].condition = condition

    def condition(self, link: Link) -> Condition:
        """The condition of a link now."""
        return self._models[link].condition

    def _enter(self, tick: int, src: int, dst: int, payload: bytes, now: ActiveFaults) -> list[Fate]:
        """Let a payload into a link; the fates of what is lost at once."""
        config, link = self.config, (src, dst)
        seq = self._next_seq[link]
        self._next_seq[link] = seq + 1
        cut = MUTE if src in now.mute else now.cut.get(link, "")
        if cut:
            self._ledger.enter(link, sent=1)
            return [_fate(Packet(tick, tick, src, seq, 0, dst, 0, payload, False), tick, cut)]
        verdicts = self._verdicts(tick * config.tick_ns, link, seq, payload, now)
        self._ledger.enter(link, sent=1, duplicated=len(verdicts) - 1)
        lost = []
        for copy, verdict in enumerate(verdicts):
            ticks = -(-verdict.delay_ns // config.tick_ns) + now.slow.get(src, 0)
            due = tick + (ticks if config.ideal else max(1, ticks))
            packet = Packet(due, tick, src, seq, copy, dst, verdict.delay_ns, verdict.payload, verdict.corrupted)
            if verdict.cause:
                lost.append(_fate(packet, tick, verdict.cause))
            else:
                heapq.heappush(self._pending[dst], packet)
        return lost

    def _verdicts(self, at_ns: int, link: Link, seq: int, payload: bytes, now: ActiveFaults) -> list[LinkOutcome]:
        """What a link does to a packet that enters it at a time."""
        model, over = self._models[link], now.conditions.get(link)
        if link in now.up:
            condition = model.condition if over is None else over
            over = condition if condition.up else replaced(condition, up=True)
        return model.enter(at_ns, seq, payload, over)

    def _announce(
        self, alive: Mapping[int, Any], until: int, now: ActiveFaults
    ) -> tuple[dict[int, tuple[Delivery, ...]], list[Fate]]:
        """The inboxes of the living, and what falls due at those who cannot hear it."""
        inboxes = {}
        unheard = []
        for i in sorted(self._pending):
            queue, inbox = self._pending[i], []
            cause = DEAD_RECEIVER if i not in alive else DEAF if i in now.deaf else ""
            while queue and queue[0].due_tick <= until:
                packet = heapq.heappop(queue)
                if cause:
                    unheard.append(_fate(packet, packet.due_tick, cause))
                else:
                    self._announced.append(packet)
                    inbox.append(Delivery(*packet[:5], packet.payload))
            if i in alive:
                inboxes[i] = tuple(inbox)
        return inboxes, unheard

    def _settle(self, until: int) -> list[Fate]:
        due = [packet for packet in self._announced if packet.due_tick <= until]
        if due:
            self._announced = [packet for packet in self._announced if packet.due_tick > until]
        final = [fate for fate in self._unheard if fate.final_tick <= until]
        if final:
            self._unheard = [fate for fate in self._unheard if fate.final_tick > until]
        return [_fate(packet, packet.due_tick, DELIVERED) for packet in due] + final

    def _book(self, fates: list[Fate]) -> tuple[Fate, ...]:
        fates.sort(key=fate_order)
        self._ledger.settle(fates)
        return tuple(fates)

    def state(self) -> dict[str, Any]:
        """Everything that determines the rest of the run, as plain values."""
        return {
            "round": self._round,
            "faults": [fault_values(fault) for fault in self.faults],
            "next_seq": [[src, dst, seq] for (src, dst), seq in sorted(self._next_seq.items())],
            "links": [
                [*link, condition_values(model.condition), model.state.to_values()]
                for link, model in sorted(self._models.items())
            ],
            "pending": [list(p) for i in sorted(self._pending) for p in sorted(self._pending[i])],
            "announced": [list(p) for p in self._announced],
            "unheard": [list(astuple(fate)) for fate in self._unheard],
            "ledger": [[*link, account.to_values()] for link, account in self._ledger.accounts.items()],
        }

    def restore(self, values: dict[str, Any]) -> None:
        """The inverse of `state`, into a core built from the same configuration."""
        self._round = values["round"]
        self.faults = tuple(fault_from_values(fault) for fault in values["faults"])
        self._next_seq = {(src, dst): seq for src, dst, seq in values["next_seq"]}
        for src, dst, condition, state in values["links"]:
            link = (src, dst)
            restored = LinkState.from_values(state)
            self._models[link] = LinkModel(condition_from_values(condition), self.config.seed, link, restored)
        self._pending = {i: [] for i in self.config.vehicles}
        for fields in values["pending"]:
            packet = Packet(*fields)
            self._pending[packet.dst].append(packet)  # sorted, and a sorted list is a heap
        self._announced = [Packet(*fields) for fields in values["announced"]]
        self._unheard = [Fate(*fields) for fields in values["unheard"]]
        for src, dst, account in values["ledger"]:
            self._ledger.accounts[(src, dst)].restore(account)


def fate_order(fate: Fate) -> tuple[int, int, int, int, int]:
    """The order of packet records in the log: (final tick, src, dst, seq, copy)."""
    return fate.final_tick, fate.src, fate.dst, fate.seq, fate.copy


def _fate(packet: Packet, final_tick: int, cause: str) -> Fate:
    return Fate(
        final_tick,
        packet.src,
        packet.dst,
        packet.seq,
        packet.copy,
        packet.sent_tick,
        packet.due_tick,
        packet.delay_ns,
        cause,
        packet.corrupted,
        packet.payload,
    )
