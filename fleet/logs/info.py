"""`fleet info`: what a log holds, in words or as plain values."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from fleet.errors import printable
from fleet.logs.decoder import Decoder
from fleet.logs.fault_intervals import FaultTime, fault_message, intervals
from fleet.logs.schemas import node_names
from fleet.mcap.reader import LogReader, OnProgress, Record, log_path, log_size
from fleet.mcap.traffic import is_attachment
from fleet.scenario.sections.timeline import FaultInterval
from fleet.scenario.sections.vehicle_events import VehicleEvents, vehicle_events
from netem.limits import LOG_FAULTS

MOST_TOPICS = 100  # in words one by one
MOST_FAULTS = 20
_WIDTH = 100  # characters; behind a longer name of a topic, numbers stand where they may


class Info(Struct, frozen=True):
    """`fleet info --json`: the content of a log at a glance."""

    path: str
    bytes: int
    messages: int
    start_s: float
    end_s: float
    run: Annotated[dict[str, str], Meta(description="All that determines the run; empty: it is no log of a run.")]
    faults: list[FaultTime]
    events: list[VehicleEvents]
    topics: dict[str, tuple[str, int]]
    missing: Annotated[str, Meta(description="Empty: the file is whole.")]
    unread: Annotated[int, Meta(description="Messages about faults that are left out above, as there are too many.")]


def read_info(path: Path, on_progress: OnProgress = lambda _: None) -> Info:
    """Read a log, whole or cut. Raises LogReadError if there is no log to read."""
    path = log_path(path)
    reader = LogReader(path, on_progress)
    counts: Counter[str] = Counter()
    first: int | None = None
    last = 0
    happened: list[Record] = []
    held = unread = 0
    for block in reader.blocks():
        for number, count in zip(*np.unique(block.channel, return_counts=True), strict=True):
            if not is_attachment(channel := reader.channels[int(number)]):  # which its sample counts
                counts[channel.topic] += int(count)
        earliest = int(block.log_ns.min())
        first = earliest if first is None else min(first, earliest)
        last = max(last, int(block.log_ns.max()))
        for record in reader.select(block, ["faults"]):
            held += len(record.data)
            if len(happened) < LOG_FAULTS.items and held <= LOG_FAULTS.bytes:
                happened.append(record)
            else:
                unread += 1
    topics = {
        channel.topic: (
            # Traffic of others has no schema, but an encoding.
            reader.schemas[channel.schema_id].name if channel.schema_id in reader.schemas else channel.message_encoding,
            counts[channel.topic],
        )
        for channel in reader.channels.values()
        if not is_attachment(channel)
    }
    found = _intervals(reader, happened, last / 1e9)
    return Info(
        path=str(path),
        bytes=log_size(path),
        messages=counts.total(),
        start_s=(first or 0) / 1e9,
        end_s=last / 1e9,
        run=reader.metadata.get("run", {}),
        faults=[FaultTime.of(one) for one in found if one.is_fault],
        events=vehicle_events((one.what, one.begin) for one in found if not one.is_fault),
        topics=topics,
        missing=reader.missing,
        unread=unread,
    )


def _intervals(reader: LogReader, happened: list[Record], end: float) -> list[FaultInterval]:
    """Faults and events of vehicles; none in the file of a stranger, whose messages may hold anything."""
    decode = Decoder(reader)
    names = node_names(reader.metadata.get("run", {}))
    read = ((record.log_ns / 1e9, fault_message(decode.message(record), names)) for record in happened)
    return intervals(((at_s, message) for at_s, message in read if message is not None), end)


def info_text(info: Info) -> str:
    """The same in words, one fact a line."""
    times = f"sim time {info.start_s:g} to {info.end_s:g} s" if info.run else f"{info.end_s - info.start_s:g} s"
    lines = [f"{info.path}: {info.messages} messages, {info.bytes / 1e6:.2f} MB, {times}"]
    if info.missing:
        lines.append(f"NOT WHOLE: {info.missing}")
    if info.run:
        lines += [f"  {key:<10} {value}" for key, value in info.run.items() if key != "graph"]
    else:
        lines.append("not a log of uuv-fleet: it says nothing of a run")
    lines += _event_lines(info)
    rows = _fold_topics(info.topics) if len(info.topics) > MOST_TOPICS else info.topics
    width = max((len(topic) for topic in rows if len(topic) <= _WIDTH), default=0)
    lines += [f"  {topic:<{width}}  {count:>8}  {schema}" for topic, (schema, count) in rows.items()]
    return "\n".join(map(printable, lines))  # a line break in a name of others begins no line


def _event_lines(info: Info) -> list[str]:
    lines = []
    if info.unread:
        limits = f"the first {LOG_FAULTS.items}, or {LOG_FAULTS.bytes >> 20} MiB, of them"
        lines.append(f"LEFT OUT: {info.unread} messages about faults; only {limits} are read")
    faults = [f"{f.id}: {f.from_s:.10g} to {f.to_s:.10g} s: {f.what}" for f in info.faults]
    for heading, some in (("faults", faults), ("events of vehicles", [*map(str, info.events)])):
        lines += [heading, *(f"  {one}" for one in some[:MOST_FAULTS])] if some else []
        if len(some) > MOST_FAULTS:
            lines.append(f"  ... and {len(some) - MOST_FAULTS} more: --json")
    return lines


def _fold_topics(topics: dict[str, tuple[str, int]]) -> dict[str, tuple[str, int]]:
    """Topics that differ by numbers alone, `uuv/1/pose` and `uuv/2/pose`, as one with all their messages."""
    alike: dict[str, list[str]] = {}
    for topic in topics:
        alike.setdefault(re.sub(r"\d+", "*", topic), []).append(topic)
    found = {}
    for pattern, some in alike.items():
        schemas = {topics[topic][0] for topic in some}
        name = f"{pattern} ({len(some)} topics)" if len(some) > 1 else some[0]
        schema = schemas.pop() if len(schemas) == 1 else f"{len(schemas)} schemas"
        found[name] = schema, sum(topics[topic][1] for topic in some)
    return found
