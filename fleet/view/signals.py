"""The signals of a log that a chart can show: their names, and their values in a message.

| name | what it is |
|---|---|
| `uuv/1/command.tau[0]` | one number of the messages of a topic |
| `command.tau_0` | the same signal of every vehicle that has it, as checks and measures name it |
| `|error.e|` | its absolute value, of a vector its Euclidean norm |
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from math import hypot
from typing import Any, NamedTuple

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.records import Channel, Schema

from fleet.logs.decoder import UNITS, decoded, known_class, units_of
from fleet.replay.topics import PublishedTopic
from fleet.scenario.sections.signals import parse_name
from netem.parsing import nearest

OF_THE_FLEET = ("transforms", "scene", "faults", "snapshot")  # topics with no signals to choose
MOST_SIGNALS = 200_000  # that are offered
WIDTH = 3  # components that are offered of a field that holds several values
_OF_A_VEHICLE = re.compile(r"uuv/(\d+)/(\w+)\.(\w+)(?:\[(\d+)\])?", re.ASCII)
_NUMBERS = frozenset({FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_UINT32})


class ChartSignal(NamedTuple):
    """One number of the messages of a topic."""

    name: str  # as in `uuv/1/command.tau[0]`
    topic: str
    field: str
    component: int | None  # of a field that holds several values
    unit: str
    absolute: bool = False

    def value(self, message: Any) -> float | None:
        """What a message says; None: nothing."""
        value = getattr(message, self.field)
        if self.component is None:
            return hypot(*(value if isinstance(value, Collection) else [value])) if self.absolute else float(value)
        if self.component >= len(value):
            return None
        return abs(value[self.component]) if self.absolute else float(value[self.component])


class Signals:
    """The signals of the channels of a log, by name."""

    def __init__(self, channels: Iterable[Channel], schemas: dict[int, Schema]) -> None:
        self._classes: dict[str, Any] = {}
        self.by_name: dict[str, ChartSignal] = {}
        self.of_vehicles: dict[str, dict[int, str]] = {}  # names by signal and vehicle
        self.followed: dict[str, list[ChartSignal]] = {}  # by topic
        for channel in sorted(channels, key=lambda channel: channel.topic):
            schema = schemas.get(channel.schema_id)
            if channel.topic in OF_THE_FLEET or schema is None or not schema.name.startswith("uuv_fleet."):
                continue
            if (cls := known_class(schema)) is not None:
                self._add(channel, cls)

    def _add(self, channel: Channel, cls: Any) -> None:
        self._classes[channel.topic] = cls
        units = units_of(channel)
        for field in cls.DESCRIPTOR.fields:
            if field.cpp_type not in _NUMBERS or len(self.by_name) >= MOST_SIGNALS:
                continue
            each = units.get(field.name, "").split(", ")
            for index in range(WIDTH) if field.is_repeated else (None,):
                name = f"{channel.topic}.{field.name}" + ("" if index is None else f"[{index}]")
                unit = each[(index or 0) % len(each)]
                self.by_name[name] = ChartSignal(name, channel.topic, field.name, index, unit)
                if found := _OF_A_VEHICLE.fullmatch(name):
                    i, group, short, _ = found.groups()
                    of_all = f"{group}.{short}" + ("" if index is None else f"_{index}")
                    self.of_vehicles.setdefault(of_all, {})[int(i)] = name

    def of_all(self, name: str) -> dict[int, str]:
        """The names of a signal of every vehicle that has it; none: there is no such signal.

        Args:
            name: as checks name it, such as `control.leader`, `command.tau_0` or `|error.e|`.
        """
        known = parse_name(name)
        if known is None:
            return {}
        if known.absolute and str(known) not in self.of_vehicles:
            self._add_absolute(known.name)
        return self.of_vehicles.get(str(known), {})

    def _add_absolute(self, name: str) -> None:
        for i, signal_name in (self.of_vehicles.get(name) or self.of_vehicles.get(f"{name}_0") or {}).items():
            one = self.by_name[signal_name]
            whole = one if name in self.of_vehicles else one._replace(component=None)
            made = f"|{whole.topic}.{whole.field}|" if whole.component is None else f"|{signal_name}|"
            self.by_name[made] = whole._replace(name=made, absolute=True)
            self.of_vehicles.setdefault(f"|{name}|", {})[i] = made

    def offered(self) -> dict[str, Any]:
        """What can be shown: the unit of each signal, and of each that vehicles have its unit and its names.

        In the names of the latter a * stands for the number of the vehicle.
        """
        fleet = {}
        for name, each in self.of_vehicles.items():
            i, first = next(iter(each.items()))
            fleet[name] = [self.by_name[first].unit, first.replace(f"uuv/{i}/", "uuv/*/", 1)]
        return {"units": self.units, "fleet": fleet}

    def meant(self, name: str) -> list[str]:
        """The names of one signal, or of a signal of all vehicles. Raises KeyError: there is no such signal."""
        names = [name] if name in self.by_name else list(self.of_all(name).values())
        if not names:
            raise KeyError(nearest(name, [*self.of_vehicles, *self.by_name]) or "the log has no such signal")
        return names

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
            message = decoded(self._classes[topic], data)
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
