"""An agent that sends again what an external agent sent in a log, because its law is not available here.

Ours does not run in its place. So `fleet verify` proves the world, the network and all other agents.

Its commands and telemetry are recorded. Its transmissions follow from the packets of its links: at least one
link has each payload as it was sent, or with a flipped bit that can be turned back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, nan
from struct import error as struct_error
from typing import Any

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError

from agents.loop import AgentLoop
from agents.sample import Decision
from agents.signals import SignalLayout
from fleet.errors import FleetError
from fleet.logs.decoder import Decoder, decode_message
from fleet.logs.schemas import (
    COMMAND,
    PACKET,
    Doubles,
    MessageField,
    signal_columns,
)
from fleet.logs.topic_names import link_of, said_topic
from fleet.mcap.reader import LogReader, Record
from fleet.scenario.scenario import Scenario
from netem.condition import Link
from netem.impairment import LinkModel
from netem.links import PERFECT
from netem.wire.messages import Delivery, Nav, Said
from world.vectors import ZERO, Vec3


class NotRecordedError(FleetError):
    """The log lacks some of the messages that an external agent sent."""


@dataclass(slots=True)
class RecordedAgent:
    """The messages of one agent, by tick."""

    vehicle: int
    layout: SignalLayout
    round_ticks: int
    last: int  # tick of the last message in the log
    commands: dict[int, Vec3] = field(default_factory=dict)
    telemetry: dict[int, list[float]] = field(default_factory=dict)
    payloads: dict[int, list[bytes]] = field(default_factory=dict)
    said: dict[int, list[Said]] = field(default_factory=dict)
    known: float = inf  # what it sent after this tick may be missing

    def loop(self, incarnation: int, begin: int) -> AgentLoop:
        core = _RecordedCore(self)
        return AgentLoop(core, self.round_ticks, incarnation=incarnation, begin=begin)


class _RecordedCore:
    def __init__(self, agent: RecordedAgent) -> None:
        self._agent = agent

    def transmit(self, nav: Nav, /) -> tuple[bytes, ...]:
        return tuple(self._agent.payloads.get(nav.tick, ()))

    def decide(self, nav: Nav, deliveries: list[Delivery], /) -> Decision:
        """Raises NotRecordedError if the log includes this tick and has no command for it."""
        agent, tick = self._agent, nav.tick
        tau = agent.commands.get(tick)
        if tau is None:
            if tick < agent.last:
                raise NotRecordedError(f"the log holds no command of vehicle {agent.vehicle} at tick {tick}")
            tau = ZERO  # the log ends within this tick, so nothing that follows is compared
        return Decision(tau, tuple(agent.telemetry.get(tick, ())), tuple(agent.said.get(tick, ())))

    def take_notes(self) -> list[tuple[int, str]]:
        return []


def recorded_agents(reader: LogReader, scenario: Scenario, last_ns: int, *, whole: bool) -> dict[int, RecordedAgent]:
    """The messages of a scenario's external agents in a log that was not read yet, by vehicle. `whole`: the log ends
    with the run, so that the fate of every packet is in it. Raises NotRecordedError if commands were thinned, or a
    message is damaged; LogReadError if a schema is.
    """
    if not scenario.external:
        return {}
    if (every := scenario.log_every["command"]) > 1:
        raise NotRecordedError(
            f"vehicle {scenario.external[0]} is external, and the log has every {every}th command only: to run it "
            "again takes all of them (log.command: 1 tick)"
        )
    reading = _Reading(reader, scenario, last_ns)
    for record in reader:
        try:
            reading.take(record)
        except (struct_error, ValueError, DecodeError):
            tick = record.log_ns // scenario.tick_ns
            raise NotRecordedError(f"a message of {record.topic} at tick {tick} is damaged") from None
    for i, agent in reading.agents.items():
        _add_payloads(agent, reading.packets[i], whole=whole or all(src != i for src, _ in scenario.graph.links))
    return reading.agents


class _Reading:
    def __init__(self, reader: LogReader, scenario: Scenario, last_ns: int) -> None:
        self._scenario, self._tick_ns, m = scenario, scenario.tick_ns, scenario.round_ticks
        self.agents = {i: RecordedAgent(i, scenario.layout(i), m, last_ns // self._tick_ns) for i in scenario.external}
        self.packets: dict[int, dict[int, tuple[int, bytes]]] = {i: {} for i in self.agents}  # by vehicle and seq
        self._sure: set[tuple[int, int]] = set()  # payloads of which an undamaged copy was seen
        self._talking = {said_topic(i): agent for i, agent in self.agents.items()}
        self._decode, self._command = Decoder(reader).ours, Doubles(COMMAND)
        self._groups = {
            (i, group): (Doubles(signal_columns(getattr(agent.layout, group))), agent.layout.group(group))
            for i, agent in self.agents.items()
            for group in ("guidance", "control")
            if getattr(agent.layout, group)
        }

    def take(self, record: Record) -> None:
        tick = record.log_ns // self._tick_ns
        head, _, rest = record.topic.partition("/")
        if head == "uuv":
            number, _, group = rest.partition("/")
            self._sample(int(number), group, tick, record.data)
        elif (agent := self._talking.get(record.topic)) is not None:
            # Commands are recorded at every tick, so there are frames at every tick: the line came with that command.
            line = decode_message(Log, record.data)
            agent.said.setdefault(tick, []).append(Said(record.publish_ns, line.file, line.message))
        elif (
            (link := link_of(record.topic)) is not None
            and link[0] in self.agents
            and (link[0], record.sequence) not in self._sure
        ):
            self._packet(link, record)

    def _sample(self, i: int, group: str, tick: int, data: bytes) -> None:
        if i in self.agents and group == "command":
            tau1, tau2, tau3, *_ = self._command.decode(data)  # the applied force and moments follow
            self.agents[i].commands[tick] = tau1, tau2, tau3
        elif (i, group) in self._groups:
            encoder, place = self._groups[i, group]
            telemetry = self.agents[i].telemetry.setdefault(tick, [nan] * self.agents[i].layout.size)
            telemetry[place] = encoder.decode(data)

    def _packet(self, link: Link, record: Record) -> None:
        src = link[0]
        message = self._message(record, PACKET)
        if message.seq > self._scenario.ticks:
            raise ValueError
        payload = message.payload
        if message.corrupted:
            model = LinkModel(self._scenario.conditions.get(link, PERFECT), self._scenario.seed, link)
            payload = model.flip_bit(payload, message.seq, message.copy)
        else:
            self._sure.add((src, message.seq))
        self.packets[src][message.seq] = record.publish_ns // self._tick_ns, payload

    def _message(self, record: Record, columns: Sequence[MessageField]) -> Any:
        if (message := self._decode(record, columns)) is None:
            raise ValueError
        return message


def _add_payloads(agent: RecordedAgent, packets: dict[int, tuple[int, bytes]], *, whole: bool) -> None:
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
