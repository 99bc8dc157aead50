"""The catalogue of a run or a replay: its topics, their schemas, and its scenario.

One side hands it out, the other asks for it. Each published sample has an attachment with its times and its place:
A MessagePack array of four unsigned integers:

| field | unit | meaning |
|---|---|---|
| `log_ns` | ns of sim time | when it happened (MCAP `log_time`) |
| `publish_ns` | ns of sim time | when it was sent (MCAP `publish_time`) |
| `sequence` | 1 | the tick, or the number of the packet on its link (MCAP `sequence`) |
| `number` | 1 | its place in the log, from 0: gaps show a subscriber of all topics what was lost |
"""

from __future__ import annotations

from typing import NamedTuple

import msgpack

from fleet.errors import FleetError
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus


class Stamp(NamedTuple):
    """The times and the place of one message of a log."""

    log_ns: int
    publish_ns: int
    sequence: int
    number: int


def pack(stamp: Stamp) -> bytes:
    data: bytes = msgpack.packb(stamp)
    return data


def unpack(data: bytes) -> Stamp:
    """The inverse of `pack`. Raises ValueError: not such an attachment."""
    try:
        values = msgpack.unpackb(data)
    except Exception as error:  # msgpack raises half a dozen unrelated types for bad bytes
        raise ValueError(f"not MessagePack ({error or type(error).__name__})") from None
    if not isinstance(values, list) or len(values) != 4 or not all(type(v) is int and v >= 0 for v in values):
        raise ValueError(f"expected four unsigned integers, got {values!r:.60}")
    return Stamp(*values)


class PublishedTopic(NamedTuple):
    """The schema of a published topic; its messages are protobuf."""

    schema: str  # name of the schema
    descriptor_set: bytes  # google.protobuf.FileDescriptorSet
    units: str  # JSON: field -> [unit, meaning]; empty: not known


def hand_out(
    bus: OpenBus,
    keys: Keys,
    topics: dict[str, str],
    schemas: dict[str, bytes],
    units: dict[str, str],
    scenario: str | None = None,
) -> None:
    """Answer queries for the topics of a journal, each with the name of its schema, for the descriptor set of each
    schema and the units of its fields, as channels have them in the log, and for the scenario as YAML."""
    if scenario is not None:
        bus.answer(keys.scenario, {keys.scenario: scenario.encode()})
    bus.answer(keys.topics, {keys.topics: msgpack.packb(topics)})
    bus.answer(keys.units, {keys.units: msgpack.packb(units)})
    bus.answer(keys.schema("*"), {keys.schema(name): data for name, data in schemas.items()})


def ask_topics(bus: OpenBus, keys: Keys) -> dict[str, PublishedTopic]:
    """The topics of a journal that is published. Raises FleetError: there is no answer, or not as this program does."""
    answer = bus.ask(keys.topics).get(keys.topics)
    if answer is None:
        raise FleetError(
            f"nobody says what is published below {keys.prefix}: is the run over, or of an older version?", status=3
        )
    schemas = bus.ask(keys.schema("*"))
    told = bus.ask(keys.units).get(keys.units)
    try:
        units = msgpack.unpackb(told) if told is not None else {}
        return {
            topic: PublishedTopic(name, schemas[keys.schema(name)], str(units.get(name, "")))
            for topic, name in msgpack.unpackb(answer).items()
        }
    except Exception as error:  # msgpack raises half a dozen unrelated types for bad bytes
        raise FleetError(
            f"what is published below {keys.prefix} is not told as expected ({error!r})", status=3
        ) from None


def ask_scenario(bus: OpenBus, keys: Keys) -> str:
    """The scenario of a live run that is published, as YAML. Raises FleetError: no answer came, or not with a text."""
    answer = bus.ask(keys.scenario).get(keys.scenario)
    try:
        if answer is not None:
            return answer.decode()
    except ValueError:
        pass
    raise FleetError(
        f"nobody says of which scenario the journal below {keys.prefix} is: is it a replay, or is the run over, or of "
        "an older version?",
        status=3,
    )
