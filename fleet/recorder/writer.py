"""The log of a run: what the journal records, encoded as messages on channels in a fixed order.

Only what determines results is written (no wall clock, host, pid or port), so that the same scenario and seed give the
same bytes. `log_time` is the tick of the event, and `publish_time` the tick at which it was sent. Both are in ns = tick
* Ts.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Callable, Mapping
from importlib.metadata import version
from math import nan
from pathlib import Path
from struct import Struct
from typing import Protocol

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from msgspec.structs import astuple

from agents.config import AgentConfig
from agents.controllers import law_class, laws
from fleet.logs.schemas import (
    BELIEF,
    CARRIED,
    CLOCK,
    CLOCK_ERROR,
    COMMAND,
    ERROR,
    FAULT,
    FIX,
    FROM,
    FROM_TICK,
    LOCATED,
    NODES,
    PACKET,
    RANGED,
    ROLL,
    START,
    STATE,
    Schema,
    flat_schema,
    foxglove_schema,
    pose_schema,
    said_data,
    said_schema,
    signal_columns,
    stamp_field,
    varint,
)
from fleet.logs.topic_names import link_topic, said_topic
from fleet.mcap.batch import Batch
from fleet.recorder.log_file import SECOND_NS
from fleet.recorder.metrics import VehicleError
from fleet.recorder.scene.messages import SCENE_UNITS, LinkHistories, Scene
from fleet.recorder.start import Start
from fleet.recorder.tick_messages import TickMessages, VehicleTopic
from fleet.recorder.transforms import TRANSFORMS_UNITS, Transforms
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.signals import OF_LOCALIZATION, OF_NAVIGATION, OF_THE_CLOCK, OF_THE_PLANT, locates
from fleet.scenario.sections.timeline import Event
from netem.cause import Cause
from netem.clock import Clock
from netem.relay import MessageFate
from netem.wire.messages import Command, Fate, Frame
from world.plants.classes import plant_class
from world.plugins.loading import fingerprint, unit_file
from world.signal import Signal

# The message of a packet, encoded by hand: a run has as many as its links carry, and protobuf's object costs 3 us.
_double = Struct("<Bd").pack  # tag, value
_RANGE_TAGS = range(0x49, 0x70, 8)  # five doubles, fields 9 to 13
_FATES = {cause: b"\x32" + varint(len(cause)) + cause.encode() for cause in Cause}


class MessageSink(Protocol):
    """The receiver of a log's messages: a file, or a comparison with another log. Times in ns of simulated time."""

    def attachment(self, name: str, media_type: str, data: bytes) -> None: ...
    def metadata(self, name: str, values: Mapping[str, str]) -> None: ...
    def channel(self, topic: str, schema: Schema) -> int: ...
    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None: ...
    def batch(self, batch: Batch) -> None: ...
    def flush(self, at_ns: int) -> None: ...


class Tap(Protocol):
    """Receives a copy of every message after the sink; it must neither wait nor raise."""

    def channel(self, number: int, topic: str, schema: Schema) -> None: ...
    def message(self, channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None: ...
    def flush(self) -> None: ...


class LogWriter:
    """Encodes the journal of one run for a sink."""

    def __init__(
        self,
        sink: MessageSink,
        scenario: Scenario,
        start: Start | None = None,
        tap: Tap | None = None,
        clock: Clock = Clock.LOCKSTEP,
        links: LinkHistories | None = None,
    ) -> None:
        """Write the scenario and declare all channels. `start`: where the run goes on from another, and `links`: of it.
        `tap` receives a copy of every message. A wall `clock` is named in the metadata. Raises LogError if the sink is
        a file and cannot be written; so do all methods.
        """
        self._sink = sink
        self._tap = tap
        self._add = sink.message if tap is None else _both(sink, tap)
        self._scenario = scenario
        self._tick_ns = scenario.tick_ns
        self._every = scenario.log_every
        self._write_head(start, clock)
        signals = {i: scenario.plant_signals(i) for i in range(1, scenario.vehicles + 1)}
        plants = {i: own for i, own in signals.items() if own is not None}
        navigating = [i for i in range(1, scenario.vehicles + 1) if scenario.belief(i)]
        self._ticks = TickMessages(
            {
                group: {
                    i: VehicleTopic(self._channel(name := f"uuv/{i}/{group}", schema), name)
                    for i, schema in schemas.items()
                }
                for group, schemas in self._schemas(plants).items()
            },
            {i: scenario.layout(i) for i in range(1, scenario.vehicles + 1)},
            plants,
            navigating,
        )
        fix = flat_schema("Fix", FIX) if navigating else None
        self._fix = None if fix is None else fix.message
        self._fixes = {} if fix is None else {i: self._channel(f"uuv/{i}/fix", fix) for i in navigating}
        self._said = {i: self._channel(said_topic(i), said_schema()) for i in scenario.speaking}
        self._scene = Scene(scenario, links)
        self._drawn = self._drawings()
        fault = flat_schema("Fault", FAULT)
        self._fault = fault.message
        self._faults = self._channel("faults", fault)
        ranging = scenario.acoustic is not None and scenario.acoustic.ranging is not None
        packet = flat_schema("RangedPacket", RANGED) if ranging else flat_schema("Packet", PACKET)
        self._packet_data = ranged_data if ranging else packet_data
        if scenario.nodes:
            packet, self._packet_data = flat_schema("CarriedPacket", CARRIED), carried_data
        self._by_link = {link: self._channel(link_topic(link), packet) for link in scenario.graph.links}

    def _write_head(self, start: Start | None, clock: Clock) -> None:
        self._sink.attachment("scenario.yaml", "application/yaml", self._scenario.to_yaml().encode())
        if start is not None:
            self._sink.attachment(START, "application/json", start.to_json())
        other = {} if clock is Clock.LOCKSTEP else {CLOCK: clock}
        self._sink.metadata("run", run_metadata(self._scenario, start) | other)

    def _drawings(self) -> dict[str, tuple[int, Callable[[Frame, bytes], bytes]]]:
        """Declare the topics that viewers draw. By topic: its channel, and the function that makes its messages."""
        drawn: dict[str, tuple[int, Callable[[Frame, bytes], bytes]]] = {}
        for group, schema, draw in (
            ("transforms", foxglove_schema(FrameTransforms, TRANSFORMS_UNITS), Transforms(self._scenario).message),
            ("scene", foxglove_schema(SceneUpdate, SCENE_UNITS), self._scene.message),
        ):
            if self._every[group]:
                drawn[group] = self._channel(group, schema), draw
        return drawn

    def _schemas(self, plants: Mapping[int, tuple[Signal, ...]]) -> dict[str, dict[int, Schema]]:
        """The schema of every topic group and vehicle; vehicles that run the same share it. `plants`: what the plant of
        each vehicle reports that has one.
        """
        ids = range(1, self._scenario.vehicles + 1)
        if self._scenario.nodes:
            told = {i: signals for i in ids if (signals := self._scenario.layout(i).control)}
            schemas = {i: flat_schema(f"Of{i}Control", signal_columns(signals)) for i, signals in told.items()}
            return {"pose": dict.fromkeys(ids, pose_schema())} | ({"control": schemas} if schemas else {})
        state = dict.fromkeys(ids, flat_schema("State", STATE))
        if plants:
            state |= dict.fromkeys(plants, flat_schema("StateWithRoll", STATE + ROLL))
        found: dict[str, dict[int, Schema]] = {
            "pose": dict.fromkeys(ids, pose_schema()),
            "state": state,
            "nav": state,
            "command": dict.fromkeys(ids, flat_schema("Command", COMMAND)),
            "guidance": {},
            "control": {},
            "error": dict.fromkeys(ids, flat_schema("Error", ERROR)),
        }
        for i in ids:
            config, layout = self._scenario.agent_config(i), self._scenario.layout(i)
            for group in ("guidance", "control"):
                if signals := getattr(layout, group):
                    found[group][i] = flat_schema(schema_name(config, group), signal_columns(signals))
        if self._scenario.clocks:
            found[OF_THE_CLOCK] = dict.fromkeys(self._scenario.clocks, flat_schema("Clock", CLOCK_ERROR))
        if plants:
            found[OF_THE_PLANT] = {}
        for i, signals in plants.items():
            if signals:
                plant = self._scenario.controls[i - 1].plant
                assert plant is not None
                found[OF_THE_PLANT][i] = flat_schema(message_name(plant.name, OF_THE_PLANT), signal_columns(signals))
        if navigating := [i for i in ids if self._scenario.belief(i)]:
            found[OF_NAVIGATION] = dict.fromkeys(navigating, flat_schema("Belief", BELIEF))
        if locating := [i for i in ids if locates(self._scenario.layout(i))]:
            found[OF_LOCALIZATION] = dict.fromkeys(locating, flat_schema("Located", LOCATED))
        return found

    def _channel(self, topic: str, schema: Schema) -> int:
        number = self._sink.channel(topic, schema)
        if self._tap is not None:
            self._tap.channel(number, topic, schema)
        return number

    def frame(self, frame: Frame, commands: Mapping[int, Command], errors: Mapping[int, VehicleError]) -> None:
        """Write all topics of one tick, topic group by topic group, vehicles in ascending order; then what is drawn."""
        tick = frame.tick
        at_ns = tick * self._tick_ns
        last = tick == self._scenario.ticks  # the state at the end is always logged, whatever the rate
        due = [group for group, every in self._every.items() if every and (last or tick % every == 0)]
        self._scene.see(frame, commands)
        stamp = stamp_field(at_ns)
        flat = [group for group in due if group not in self._drawn]
        if flat:
            batch = self._ticks(frame, commands, errors, flat, at_ns, stamp)
            self._sink.batch(batch)
            if self._tap is not None:
                for message in batch.messages():
                    self._tap.message(*message)
        if self._fixes:
            self._write_fixes(frame, at_ns)
        for i, said in ((line.vehicle, line.said) for line in frame.said):
            self._add(self._said[i], at_ns, said.at_ns, tick, said_data(f"vehicle {i}", said))
        for group in due:
            if group in self._drawn:
                channel, draw = self._drawn[group]
                self._add(channel, at_ns, at_ns, tick, draw(frame, stamp))
        self._sink.flush(at_ns)
        if self._tap is not None:
            self._tap.flush()

    def _write_fixes(self, frame: Frame, at_ns: int) -> None:
        tick_s = self._tick_ns / 1e9
        for row in frame.vehicles:
            for fix in row.fixes:
                assert self._fix is not None
                north, east = fix.position
                message = self._fix(
                    source=fix.source, measured=fix.measured * tick_s, at=fix.tick * tick_s, north=north, east=east,
                    sigma=fix.sigma, nis=fix.nis, used=fix.used,
                )  # fmt: skip
                measured_ns = fix.measured * self._tick_ns
                self._add(self._fixes[row.id], at_ns, measured_ns, fix.measured, message.SerializeToString())

    def packet(self, fate: Fate) -> None:
        self._scene.links.settle(fate)
        tick_ns = self._tick_ns
        final_ns = fate.final_tick * tick_ns
        channel, data = self._by_link[fate.src, fate.dst], self._packet_data(fate, tick_ns)
        self._add(channel, final_ns, fate.sent_tick * tick_ns, fate.seq, data)
        self._sink.flush(final_ns)

    def event(self, event: Event) -> None:
        message = self._fault(fault=event.fault, action=event.action, what=event.what)
        at_ns = event.tick * self._tick_ns
        self._add(self._faults, at_ns, at_ns, event.tick, message.SerializeToString())
        self._sink.flush(at_ns)

    @property
    def links(self) -> LinkHistories:
        """What became of the last packets of each link."""
        return self._scene.links


def _both(sink: MessageSink, tap: Tap) -> Callable[[int, int, int, int, bytes], None]:
    def message(channel: int, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        sink.message(channel, log_ns, publish_ns, sequence, data)
        tap.message(channel, log_ns, publish_ns, sequence, data)

    return message


def scenario_metadata(scenario: Scenario) -> dict[str, str]:
    """What of the metadata a scenario says without its laws."""
    return {
        "scenario": scenario.name,
        "seed": str(scenario.seed),
        "tick_ns": str(scenario.tick_ns),
        "ticks": str(scenario.ticks),
        "vehicles": str(scenario.vehicles),
        "graph": " ".join(f"{src}->{dst}" for src, dst in scenario.graph.links),
    }


def run_metadata(scenario: Scenario, start: Start | None = None) -> dict[str, str]:
    """The metadata that determine a run's result, in addition to the scenario attachment."""
    scenarios = [scenario, *(leg.scenario for leg in (start.legs if start is not None else ()))]
    sources = {f"law {law.name}": law_class(kind, law) for each in scenarios for kind, law in each.other_laws}
    plants = {name: plant for each in scenarios for name, plant in each.plants.items()}
    sources |= {f"plant {name}": plant_class(name, plant.parameters or {}) for name, plant in plants.items()}
    found = scenario_metadata(scenario) | {
        "uuv-fleet": version("uuv-fleet"),
        "piqp": version("piqp"),
        "python": ".".join(platform.python_version_tuple()[:2]),
        "resumable": _resumable(scenario),
        **{what: f"sha256 {fingerprint(c)}" for what, c in sources.items()},
        **({NODES: " ".join(scenario.nodes)} if scenario.nodes else {}),
    }
    if start is not None:
        found |= {FROM_TICK: str(start.tick), FROM: start.source}
    return found


def _resumable(scenario: Scenario) -> str:
    if scenario.nodes:
        return "no: its programs are not ours"
    if scenario.external:
        return f"no: {', '.join(map(str, scenario.external))} external, whose agents keep what they remember"
    return "yes"


def schema_name(config: AgentConfig, group: str) -> str:
    """The name of the message of a topic group, after the law that fills it."""
    running = laws(config)
    law = running.get({"guidance": "guidance", "control": "tracking"}[group]) or next(iter(running.values()))
    if file := unit_file("agent", law.name):
        return message_name(f"program {Path(file).stem}", group)  # not the path, which is another one elsewhere
    return message_name(law.name, group)


def message_name(name: str, group: str) -> str:
    """The name of the message of a topic group, after the law or plant that fills it."""
    if ":" in name:
        return f"{name.replace(':', '.')}{group.capitalize()}"
    words = re.findall(r"[A-Za-z0-9]+", name)
    return "".join(word[0].upper() + word[1:] for word in words) + group.capitalize()


def packet_data(fate: Fate, tick_ns: int) -> bytes:
    """A fate as the message `Packet` of `fleet.logs.schemas.PACKET`; as in all of protobuf, zeros are left out."""
    data = b"\x08" + varint(fate.seq) if fate.seq else b""
    if fate.copy:
        data += b"\x10" + varint(fate.copy)
    if fate.sent_tick:
        data += _double(0x19, fate.sent_tick * tick_ns / SECOND_NS)
    if fate.due_tick:
        data += _double(0x21, fate.due_tick * tick_ns / SECOND_NS)
    if fate.delay_ns:
        data += _double(0x29, fate.delay_ns / SECOND_NS)
    data += _FATES[fate.cause]
    payload = fate.payload
    if payload:
        data += b"\x3a" + varint(len(payload)) + payload
    return data + b"\x40\x01" if fate.corrupted else data


def ranged_data(fate: Fate, tick_ns: int) -> bytes:
    """The same as the message `RangedPacket`, with what its receiver's modem has measured."""
    measured = fate.measured
    values = (nan,) * 5
    if measured is not None:
        range_m, sd_m, tick, distance_m = astuple(measured)
        values = (range_m, sd_m, tick * tick_ns / SECOND_NS, distance_m, range_m - distance_m)
    return packet_data(fate, tick_ns) + b"".join(map(_double, _RANGE_TAGS, values))


def carried_data(fate: Fate, tick_ns: int) -> bytes:
    """The same as the message `CarriedPacket`, of a packet between nodes."""
    assert isinstance(fate, MessageFate)
    key, kind = fate.key.encode(), fate.kind.encode()
    own = b"\x4a" + varint(len(key)) + key + b"\x52" + varint(len(kind)) + kind
    return packet_data(fate, tick_ns) + own + (b"\x58" + varint(fate.size) if fate.size else b"")
