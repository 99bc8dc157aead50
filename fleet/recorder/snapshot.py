"""Snapshots: everything that determines the rest of a run, in its log at a stated interval.

Another run can go on from there.

A snapshot belongs to a round tick S, before the vehicles measure. It has the vehicles at S, and the network before the
round of S. It also has every agent's memory after its sample S - 1, with deliveries that are not due yet. Faults are
not in it: they are in the scenario, or in the log. It is plain values as MessagePack, never pickled objects, with their
CRC-32: what no run can hold would fail somewhere in the world, the network or an agent.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack

from fleet.errors import FleetError
from fleet.quantities import show_time
from world.config import vehicle_memories

if TYPE_CHECKING:
    from fleet.logs.reader import LogReader, Tell

TOPIC = "snapshot"
_FORMAT = 2  # 1: without the CRC


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One moment of a run."""

    tick: int
    world: dict[str, Any]  # as `world.config` says, the agents' memories in it
    network: dict[str, Any]  # of netem.network
    heard: list[list[int]]  # [src, dst, newest tick of sending that arrived] of each link
    drawn: list[list[Any]] = field(default_factory=list)  # what became of the last packets; see `fleet.recorder.scene`

    def to_bytes(self) -> bytes:
        fields: bytes = msgpack.packb([self.tick, self.world, self.network, self.heard, self.drawn])
        packed: bytes = msgpack.packb([_FORMAT, zlib.crc32(fields), fields])
        return packed

    @classmethod
    def from_bytes(cls, data: bytes) -> Snapshot:
        """The inverse of `to_bytes`. Raises FleetError if it is damaged or of another format."""
        try:
            form, *fields = msgpack.unpackb(data)
            if form == _FORMAT:
                crc, packed = fields
                if zlib.crc32(packed) != crc:
                    raise FleetError("the snapshot is damaged: its CRC is of other bytes")
                fields = msgpack.unpackb(packed)
            if form in (1, _FORMAT):
                return cls(*fields)
        except (ValueError, TypeError, msgpack.UnpackException) as error:
            raise FleetError(f"the snapshot cannot be read ({error or type(error).__name__})") from None
        raise FleetError(f"the snapshot is of format {form}, this version reads up to {_FORMAT}")

    @property
    def memories(self) -> dict[int, bytes]:
        """Each agent's memory; without the agents that are not there."""
        return {known.vehicle: known.agent for known in vehicle_memories(self.world) if known.agent}


def find(path: Path, at_ns: int | None = None, tell: Tell = lambda _: None) -> Snapshot:
    """The last snapshot of a log up to a time; None: the last there is. Raises LogReadError if there is no log to read;
    FleetError if it has no such snapshot.
    """
    from fleet.logs.decoder import Decoder  # a run writes snapshots and reads none
    from fleet.logs.reader import LogReader, log_path
    from fleet.logs.schemas import SNAPSHOT

    path = log_path(path)
    reader = LogReader(path, tell)
    decode = Decoder(reader)
    first: int | None = None
    found: bytes | None = None
    for record in reader.of([TOPIC]):
        first = record.log_ns if first is None else first
        if at_ns is None or record.log_ns <= at_ns:
            if (message := decode.ours(record, SNAPSHOT)) is None:
                raise FleetError(f"{path}: the snapshot at {show_time(record.log_ns)} is damaged")
            found = message.state
    if found is None:
        there = f"the first is at {show_time(first)}" if first is not None else _none(reader)
        raise FleetError(
            f"{path} has no snapshot" + ("" if at_ns is None else f" up to {show_time(at_ns)}") + f": {there}"
        )
    return Snapshot.from_bytes(found)


def _none(reader: LogReader) -> str:
    run = reader.metadata.get("run", {})
    if run.get("resumable", "yes") != "yes":
        return run["resumable"].removeprefix("no: ")
    return "it ended before the first, or has log.snapshot: 0 s"


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run begins that goes on from another."""

    snapshot: Snapshot
    source: str  # the log, and its digest
    anew: tuple[int, ...] = ()  # vehicles whose agents begin without memory
    notes: tuple[str, ...] = field(default=())
