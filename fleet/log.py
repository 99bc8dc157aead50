"""The MCAP log: channels in a fixed order, sim time only, and a digest over the ordered messages.

Only what determines results goes in (no wall clock, host, pid or port), so that the same scenario and seed give
the same bytes. `log_time` is the tick at which something happened, `publish_time` the tick it was sent; both are
ns = tick * Ts.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from importlib.metadata import version
from math import cos, sin
from pathlib import Path
from struct import pack
from typing import IO, Any

from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer

from agents.agent import Agent
from fleet.errors import FleetError
from fleet.log_schemas import (
    COMMAND,
    ERROR,
    PACKET,
    STATE,
    Schema,
    flat_schema,
    pose_schema,
    signal_columns,
)
from fleet.metrics import VehicleError
from fleet.scenario import Scenario
from netem.messages import Command, Fate, Frame, VehicleFrame, decode

SECOND_NS = 1_000_000_000
FRAME_ID = "ned"


class LogError(FleetError):
    """The log cannot be written: the disk is full, or the place is not writable."""


class LogWriter:
    """Writes the journal of one run. `close` finishes the file; without it the file is cut but readable."""

    def __init__(self, path: Path, scenario: Scenario) -> None:
        self.path = path
        self._scenario = scenario
        self._tick_ns = scenario.tick_ns
        self._every = scenario.log_every
        self._digest = hashlib.sha256()
        self.messages = 0
        self._flushed_s = 0
        self._signals = Agent.signals
        try:
            self._file: IO[bytes] = path.open("xb")
            self._start()
        except OSError as error:
            raise _log_error(path, error) from error

    @property
    def digest(self) -> str:
        """SHA-256 over (topic, log_time, publish_time, sequence, data) of every message so far."""
        return self._digest.hexdigest()

    def _start(self) -> None:
        # Without `library` the mcap version would stand in the file, and bytes would differ between versions.
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="uuv-fleet")
        self._writer.add_attachment(0, 0, "scenario.yaml", "application/yaml", self._scenario.to_yaml().encode())
        self._writer.add_metadata("run", run_metadata(self._scenario))
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[str, tuple[int, str]] = {}
        ids = range(1, self._scenario.vehicles + 1)
        controller = self._scenario.spec.controller.capitalize()
        flat = {
            "state": flat_schema("State", STATE),
            "nav": flat_schema("State", STATE),
            "command": flat_schema("Command", COMMAND),
            "guidance": flat_schema(f"{controller}Guidance", signal_columns(self._signals, "guidance")),
            "control": flat_schema(f"{controller}Control", signal_columns(self._signals, "control")),
            "error": flat_schema("Error", ERROR),
        }
        registered: dict[str, int] = {}
        for group, schema in {"pose": pose_schema(), **flat}.items():
            for i in ids:
                self._channel(f"uuv/{i}/{group}", schema, registered)
            self._schemas[group] = schema
        self._schemas["link"] = flat_schema("Packet", PACKET)
        for src, dst in self._scenario.graph.links:
            self._channel(f"link/{src}-{dst}", self._schemas["link"], registered)

    def _channel(self, topic: str, schema: Schema, registered: dict[str, int]) -> None:
        if schema.name not in registered:
            registered[schema.name] = self._writer.register_schema(schema.name, "protobuf", schema.descriptor_set)
        number = self._writer.register_channel(topic, "protobuf", registered[schema.name], {"units": schema.units})
        self._channels[topic] = (number, topic)

    def frame(self, frame: Frame, errors: Mapping[int, VehicleError]) -> None:
        """Write all topics of one tick, topic group by topic group, vehicles in ascending order."""
        tick = frame.tick
        at_ns = tick * self._tick_ns
        # The state at the end is always logged, whatever the rate.
        groups = [g for g, every in self._every.items() if tick % every == 0 or tick == self._scenario.ticks]
        commands: dict[int, Command] = {}
        if any(g in ("command", "guidance", "control") for g in groups):
            for row in frame.vehicles:
                if row.command:
                    command = decode(row.command)
                    assert isinstance(command, Command)  # the world checked it before it went into the frame
                    commands[row.id] = command
        for group in groups:
            for row in frame.vehicles:
                data = self._encode(group, row, commands.get(row.id), errors[row.id], at_ns)
                if data is not None:
                    self._add(f"uuv/{row.id}/{group}", at_ns, at_ns, tick, data)
        self._flush(at_ns)

    def packet(self, fate: Fate) -> None:
        """Write one packet's final fate."""
        tick_ns = self._tick_ns
        message = self._schemas["link"].message(
            seq=fate.seq,
            copy=fate.copy,
            sent=fate.sent_tick * tick_ns / SECOND_NS,
            due=fate.due_tick * tick_ns / SECOND_NS,
            delay=fate.delay_ns / SECOND_NS,
            fate=fate.cause,
            payload=fate.payload,
        )
        final_ns = fate.final_tick * tick_ns
        data = message.SerializeToString()
        self._add(f"link/{fate.src}-{fate.dst}", final_ns, fate.sent_tick * tick_ns, fate.seq, data)
        self._flush(final_ns)

    def close(self) -> None:
        """Write the index and close the file."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
        except OSError as error:
            raise _log_error(self.path, error) from error

    def abandon(self) -> None:
        """Close the file after a write failed; what was flushed before stays readable."""
        try:
            self._file.close()
        except OSError:
            # The buffer could not be written either: the error is already on its way to the user.
            return

    def _encode(
        self, group: str, row: VehicleFrame, command: Command | None, error: VehicleError, at_ns: int
    ) -> bytes | None:
        make = self._schemas[group].message
        data: bytes
        match group:
            case "pose":
                data = make(**_pose(row, at_ns)).SerializeToString()
            case "state":
                data = _state(make, (*row.eta, *row.nu))
            case "nav":
                if not row.nav:
                    return None
                data = _state(make, row.nav)
            case "command":
                if command is None:
                    return None
                data = make(tau=command.tau, applied=row.tau).SerializeToString()
            case "error":
                data = make(
                    e=error.e,
                    e_norm=error.e_norm,
                    formation=error.formation,
                    formation_norm=error.formation_norm,
                ).SerializeToString()
            case _:
                if command is None:
                    return None
                data = make(**self._telemetry(group, command.telemetry)).SerializeToString()
        return data

    def _telemetry(self, group: str, telemetry: tuple[float, ...]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        position = 0
        for signal in self._signals:
            if signal.group == group:
                if signal.width == 1:
                    values[signal.name] = telemetry[position]
                else:
                    values[signal.name] = telemetry[position : position + signal.width]
            position += signal.width
        return values

    def _add(self, topic: str, log_ns: int, publish_ns: int, sequence: int, data: bytes) -> None:
        number, name = self._channels[topic]
        try:
            self._writer.add_message(number, log_ns, data, publish_ns, sequence)
        except OSError as error:
            raise _log_error(self.path, error) from error
        self._digest.update(name.encode() + pack("<QQII", log_ns, publish_ns, sequence, len(data)) + data)
        self.messages += 1

    def _flush(self, at_ns: int) -> None:
        # On sim time, not on the wall clock: chunk borders are part of the bytes.
        second = at_ns // SECOND_NS
        if second > self._flushed_s:
            self._flushed_s = second
            try:
                self._writer.flush()  # type: ignore[no-untyped-call]
            except OSError as error:
                raise _log_error(self.path, error) from error


def run_metadata(scenario: Scenario) -> dict[str, str]:
    """What determines a run's result besides the scenario attachment."""
    return {
        "scenario": scenario.name,
        "seed": str(scenario.seed),
        "tick_ns": str(scenario.tick_ns),
        "ticks": str(scenario.ticks),
        "vehicles": str(scenario.vehicles),
        "graph": " ".join(f"{src}->{dst}" for src, dst in scenario.graph.links),
        "uuv-fleet": version("uuv-fleet"),
        "piqp": version("piqp"),
        "python": ".".join(platform.python_version_tuple()[:2]),
    }


def _state(make: Any, values: tuple[float, ...]) -> bytes:
    x, y, z, theta, psi, u, v, w, q, r = values
    data: bytes = make(x=x, y=y, z=z, theta=theta, psi=psi, u=u, v=v, w=w, q=q, r=r).SerializeToString()
    return data


def _pose(row: VehicleFrame, at_ns: int) -> dict[str, Any]:
    x, y, z, theta, psi = row.eta
    # R = Rz(psi) Ry(theta); roll is not modelled.
    ct, st, cp, sp = cos(theta / 2), sin(theta / 2), cos(psi / 2), sin(psi / 2)
    return {
        "timestamp": Timestamp(seconds=at_ns // SECOND_NS, nanos=at_ns % SECOND_NS),
        "frame_id": FRAME_ID,
        "pose": {
            "position": {"x": x, "y": y, "z": z},
            "orientation": {"x": -sp * st, "y": cp * st, "z": sp * ct, "w": cp * ct},
        },
    }


def _log_error(path: Path, error: OSError) -> LogError:
    return LogError(f"cannot write the log {path}: {error.strerror or error}")
