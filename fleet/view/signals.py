"""The signals of a log that a chart can show: their names, and their values in a message."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.records import Channel, Schema

from fleet.logs.decoder import UNITS, message_class, units_of
from fleet.replay.topics import PublishedTopic
from netem.parsing import nearest

OF_THE_FLEET = ("transforms", "scene", "faults", "snapshot")  # topics with no signals to choose
WIDTH = 3  # components that are offered of a field that holds several values
_NUMBERS = frozenset({FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_UINT32})


class Signal(NamedTuple):
    """One number of the messages of a topic."""

    name: str  # as in `uuv/1/command.tau[0]`
    topic: str
    field: str
    component: int | None  # of a field that holds several values
    unit: str

    def value(self, message: Any) -> float | None:
        """What a message says; None: nothing."""
        value = getattr(message, self.field)
        if self.component is None:
            return float(value)
        return float(value[self.component]) if self.component < len(value) else None


class Signals:
    """The signals of the channels of a log, by name."""

    def __init__(self, channels: Iterable[Channel], schemas: dict[int, Schema]) -> None:
        self._classes: dict[str, Any] = {}
        self.by_name: dict[str, Signal] = {}
        self.followed: dict[str, list[Signal]] = {}  # by topic
        for channel in sorted(channels, key=lambda channel: channel.topic):
            schema = schemas.get(channel.schema_id)
            if channel.topic in OF_THE_FLEET or schema is None or not schema.name.startswith("uuv_fleet."):
                continue
            cls = self._classes[channel.topic] = message_class(schema)
            units = units_of(channel)
            for field in cls.DESCRIPTOR.fields:
                if field.cpp_type not in _NUMBERS:
                    continue
                each = units.get(field.name, "").split(", ")
                for index in range(WIDTH) if field.is_repeated else (None,):
                    name = f"{channel.topic}.{field.name}" + ("" if index is None else f"[{index}]")
                    unit = each[(index or 0) % len(each)]
                    self.by_name[name] = Signal(name, channel.topic, field.name, index, unit)

    @property
    def units(self) -> dict[str, str]:
        """The unit of each signal, by its name."""
        return {name: signal.unit for name, signal in self.by_name.items()}

    def follow(self, names: Collection[str]) -> None:
        """Follow these signals and no others. Raises KeyError: there is none of a name, and all stays as it was."""
        for name in names:
            if name not in self.by_name:
                raise KeyError(nearest(name, self.by_name) or "the log has no such signal")
        self.followed = {}
        for signal in map(self.by_name.__getitem__, sorted(names)):
            self.followed.setdefault(signal.topic, []).append(signal)

    def values(self, topic: str, data: bytes) -> Iterator[tuple[str, float]]:
        """What a message says of the signals that are followed; nothing if it is damaged."""
        if not (some := self.followed.get(topic)):
            return
        try:
            message = self._classes[topic].FromString(data)
        except DecodeError:
            return
        for signal in some:
            if (value := signal.value(message)) is not None:
                yield signal.name, value


def published_signals(topics: Mapping[str, PublishedTopic]) -> Signals:
    """The signals of a journal that is published."""
    channels, schemas = [], {}
    for number, (topic, (name, descriptor_set, units)) in enumerate(topics.items(), start=1):
        channels.append(Channel(number, topic, "protobuf", {UNITS: units}, number))
        schemas[number] = Schema(number, descriptor_set, "protobuf", name)
    return Signals(channels, schemas)


def commands_of(vehicle: int) -> list[str]:
    """The names of what a vehicle's agent commands: surge force, pitch and yaw moment."""
    return [f"uuv/{vehicle}/command.tau[{k}]" for k in range(WIDTH)]
