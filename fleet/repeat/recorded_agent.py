"""An agent that sends again what an external agent sent in a log, whose law is not available here.

Its commands, telemetry and memory are recorded; what it transmitted follows from the packets of its links, one of which
at least has each payload as it was sent, or with a flipped bit that can be turned back.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, nan
from struct import error as struct_error
from typing import Any

from agents.decision import Decision
from agents.loop import AgentLoop
from agents.signals import SignalLayout
from fleet.errors import FleetError
from fleet.logs.decoder import Decoder
from fleet.logs.reader import LogReader
from fleet.logs.schemas import COMMAND, PACKET, SNAPSHOT, Doubles, signal_columns
from fleet.recorder.snapshot import TOPIC, Snapshot
from fleet.scenario.scenario import Scenario
from netem.impairment import LinkModel
from netem.links import PERFECT
from netem.wire.messages import Delivery, Nav
from world.vectors import ZERO, Vec3


class NotRecordedError(FleetError):
    """The log does not hold all that an external agent sent."""


@dataclass(slots=True)
class RecordedAgent:
    """What one agent sent, by tick."""

    vehicle: int
    layout: SignalLayout
    round_ticks: int
    last: int  # tick of the last message in the log
    commands: dict[int, Vec3] = field(default_factory=dict)
    telemetry: dict[int, list[float]] = field(default_factory=dict)
    payloads: dict[int, list[bytes]] = field(default_factory=dict)
    memories: dict[int, bytes] = field(default_factory=dict)
    known: float = inf  # what it sent after this tick may be missing

    def loop(self, incarnation: int, begin: int) -> AgentLoop:
        """A life of it."""
        core = _RecordedCore(self)
        return AgentLoop(core, self.round_ticks, incarnation=incarnation, begin=begin, memories=self.memories)


class _RecordedCore:
    def __init__(self, agent: RecordedAgent) -> None:
        self._agent = agent

    def transmit(self, nav: Nav, /) -> tuple[bytes, ...]:
        return tuple(self._agent.payloads.get(nav.tick, ()))

    def decide(self, nav: Nav, deliveries: list[Delivery], /) -> Decision:
        """Raises NotRecordedError for a tick within the log of which it holds no command."""
        agent, tick = self._agent, nav.tick
        tau = agent.commands.get(tick)
        if tau is None:
            if tick < agent.last:
                raise NotRecordedError(f"the log holds no command of vehicle {agent.vehicle} at tick {tick}")
            tau = ZERO  # of a log that ends within this tick: nothing that follows is compared
        return Decision(tau, tuple(agent.telemetry.get(tick, ())))

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, values: dict[str, Any], /) -> None:
        raise AssertionError("a run with external agents does not go on from a snapshot")

    def take_notes(self) -> list[tuple[int, str]]:
        return []


def recorded_agents(reader: LogReader, scenario: Scenario, last_ns: int, *, whole: bool) -> dict[int, RecordedAgent]:
    """What the external agents of a scenario sent in a log, by vehicle.

    Args:
        reader: of the log, not read yet.
        last_ns: time of its last message.
        whole: the log ends with the run, so that the fate of every packet is in it.

    Raises:
        NotRecordedError: commands were thinned, or a message is damaged.
        LogReadError: a schema is.
    """
    if not scenario.external:
        return {}
    if (every := scenario.log_every["command"]) > 1:
        raise NotRecordedError(
            f"vehicle {scenario.external[0]} is external, and the log has every {every}th command only: to run it "
            "again takes all of them (log.command: 1 tick)"
        )
    tick_ns, m = scenario.tick_ns, scenario.round_ticks
    found = {i: RecordedAgent(i, scenario.layout(i), m, last_ns // tick_ns) for i in scenario.external}
    packets: dict[int, dict[int, tuple[int, bytes]]] = {i: {} for i in found}  # by vehicle and seq
    sure: set[tuple[int, int]] = set()  # those of which an undamaged copy was seen
    decode, command = Decoder(reader).ours, Doubles(COMMAND)
    groups = {
        (i, group): (Doubles(signal_columns(getattr(agent.layout, group))), agent.layout.group(group))
        for i, agent in found.items()
        for group in ("guidance", "control")
        if getattr(agent.layout, group)
    }
    for record in reader:
        tick = record.log_ns // tick_ns
        try:
            head, _, rest = record.topic.partition("/")
            if head == "uuv":
                number, _, group = rest.partition("/")
                i = int(number)
                if i in found and group == "command":
                    tau1, tau2, tau3, *_ = command.decode(record.data)  # those that were applied follow
                    found[i].commands[tick] = tau1, tau2, tau3
                elif (i, group) in groups:
                    encoder, place = groups[i, group]
                    telemetry = found[i].telemetry.setdefault(tick, [nan] * found[i].layout.size)
                    telemetry[place] = encoder.decode(record.data)
            elif head == "link":
                src, dst = map(int, rest.split("-"))
                if src in found and (src, record.sequence) not in sure:
                    if (message := decode(record, PACKET)) is None or message.seq > scenario.ticks:
                        raise ValueError
                    payload = message.payload
                    if message.corrupted:
                        model = LinkModel(scenario.conditions.get((src, dst), PERFECT), scenario.seed, (src, dst))
                        payload = model.flipped(payload, message.seq, message.copy)
                    else:
                        sure.add((src, message.seq))
                    packets[src][message.seq] = record.publish_ns // tick_ns, payload
            elif head == TOPIC:
                if (message := decode(record, SNAPSHOT)) is None:
                    raise ValueError
                memories = Snapshot.from_bytes(message.state).memories
                for i in found.keys() & memories.keys():
                    found[i].memories[tick] = memories[i]
        except (struct_error, ValueError):
            raise NotRecordedError(f"a message of {record.topic} at tick {tick} is damaged") from None
    for i, agent in found.items():
        _transmitted(agent, packets[i], whole=whole or all(src != i for src, _ in scenario.graph.links))
    return found


def _transmitted(agent: RecordedAgent, packets: dict[int, tuple[int, bytes]], *, whole: bool) -> None:
    """The payloads of each tick. A payload whose fate is not in a cut log keeps its place and is empty."""
    tick = 0
    for seq in range(max(packets, default=-1) + 1):
        if seq in packets:
            tick, payload = packets[seq]
        else:
            agent.known = min(agent.known, tick)
            following = next(packets[later][0] for later in range(seq, max(packets) + 1) if later in packets)
            tick, payload = (tick + agent.round_ticks if following - tick > agent.round_ticks else tick), b""
        agent.payloads.setdefault(tick, []).append(payload)
    if not whole:
        agent.known = min(agent.known, tick)
