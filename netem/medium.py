"""The medium of the payloads of a run: a link of its own for each pair, or water that all share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from netem.condition import Condition, Link
from netem.config import NetemConfig
from netem.fault_kinds import Cause
from netem.faults import ActiveFaults
from netem.impairment import LinkModel, LinkOutcome
from netem.ledger import Ledger
from netem.link_states import LinkStates, StateProcess
from netem.link_trace import TraceProcess
from netem.transit import HeldPacket, PendingPacket, Transit
from netem.vehicle_clock import Clocks
from netem.wire.messages import Fate

# --- links
# The directed links of a run: the receivers of each vehicle, the effect and the packet counts of each link.

PERFECT = Condition()


class Links:
    """The links, as a medium uses them. As long as a fault gives a link another condition, the link has that one."""

    def __init__(self, config: NetemConfig) -> None:
        self.models = {
            link: LinkModel(config.conditions.get(link, PERFECT), config.seed, link) for link in config.links
        }
        self.receivers: dict[int, list[int]] = {i: [] for i in config.vehicles}
        for src, dst in sorted(config.links):
            self.receivers[src].append(dst)
        # What a radio sends leaves it one after the other, to whomever. It draws nothing.
        self.radios = {i: LinkModel(condition, config.seed, (i, 0)) for i, condition in config.radios.items()}
        self.next_seq: dict[Link, int] = dict.fromkeys(config.links, 0)
        self.ledger = Ledger(config.links)

    def take_over(self, before: Links) -> None:
        """Go on from the links of another run: what they remember, their numbers and counts; not their conditions."""
        for link, model in self.models.items():
            model.take_over(before.models[link])
        for i, radio in self.radios.items():
            if i in before.radios:
                radio.take_over(before.radios[i])
        self.next_seq, self.ledger = before.next_seq, before.ledger

    def number(self, link: Link) -> int:
        """The number of the next payload on a link, from 0; each is given once."""
        seq = self.next_seq[link]
        self.next_seq[link] = seq + 1
        return seq

    def enter(
        self, at_ns: int, link: Link, seq: int, payload: bytes, faults: ActiveFaults, wait_ns: int = 0
    ) -> list[LinkOutcome]:
        """The outcome of a packet that enters a link at a time, and a second outcome if the link duplicates it.
        `wait_ns`: how much later its radio has sent it; delays count from then.
        """
        model, over = self.models[link], faults.conditions.get(link)
        if link in faults.up:
            condition = model.condition if over is None else over
            over = condition if condition.up else replace(condition, up=True)
        return model.enter(at_ns + wait_ns, seq, payload, over)

    def transmit(
        self, radio: LinkModel, at_ns: int, link: Link, seq: int, payload: bytes, faults: ActiveFaults
    ) -> list[LinkOutcome]:
        """The outcomes of a packet that goes through the radio of its sender first."""
        (sent,) = radio.enter(at_ns, seq, payload)
        if sent.cause is not None:
            return [sent]
        outcomes = self.enter(at_ns, link, seq, payload, faults, sent.delay_ns)
        return [o if o.cause is not None else o._replace(delay_ns=sent.delay_ns + o.delay_ns) for o in outcomes]


class ChangingLinks(Links):
    """The links of a run in which the condition of some links changes by itself, between states or by a trace.

    As long as a fault gives a link another condition, the link has that one.
    """

    def __init__(self, config: NetemConfig) -> None:
        super().__init__(config)
        self._processes: dict[Link, StateProcess | TraceProcess] = {}
        shared: dict[LinkStates, StateProcess] = {}
        for link, changing in config.changing.items():
            if not isinstance(changing, LinkStates):
                self._processes[link] = TraceProcess(config.seed, changing, link)
            elif changing.shared is None:
                self._processes[link] = StateProcess(config.seed, changing, link)
            else:
                if changing not in shared:
                    shared[changing] = StateProcess(config.seed, changing, link)
                self._processes[link] = shared[changing]

    def enter(
        self, at_ns: int, link: Link, seq: int, payload: bytes, faults: ActiveFaults, wait_ns: int = 0
    ) -> list[LinkOutcome]:
        """The outcome of a packet, in the condition that the link has when the packet enters it."""
        process = self._processes.get(link)
        if process is None or link in faults.conditions:
            return super().enter(at_ns, link, seq, payload, faults, wait_ns)
        condition = process.condition(at_ns, seq)
        if link in faults.up and not condition.up:
            condition = replace(condition, up=True)
        return self.models[link].enter(at_ns + wait_ns, seq, payload, condition)


def make_links(config: NetemConfig) -> Links:
    """The links of a run. Links that never change skip the question for their state."""
    return ChangingLinks(config) if config.changing else Links(config)


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
