"""The directed links of a run: the receivers of each vehicle, the effect and the packet counts of each link."""

from __future__ import annotations

from dataclasses import replace

from netem.condition import Condition, Link
from netem.config import NetemConfig
from netem.faults import ActiveFaults
from netem.impairment import LinkModel, LinkOutcome
from netem.ledger import Ledger
from netem.link_states import LinkStates, StateProcess
from netem.link_trace import TraceProcess

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
