"""The signals of a log that a chart can show, and their values in a message.

Their names are those of `fleet.scenario.sections.signals`; those of other topics follow them: `link/1-2.delay`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from math import hypot
from typing import Any, NamedTuple

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.records import Channel, Schema

from fleet.logs.decoder import UNITS, decode_message, known_class, units_of
from fleet.replay.topics import PublishedTopic
from fleet.scenario.sections.signals import SignalName, component, parse_name
from netem.parsing import nearest

OF_THE_FLEET = ("transforms", "scene", "faults", "snapshot")  # topics with no signals to choose
MOST_SIGNALS = 200_000  # that are offered
WIDTH = 3  # components that are offered of a field that holds several values
_NUMBERS = frozenset({FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT, FieldDescriptor.CPPTYPE_UINT32})


class ChartSignal(NamedTuple):
    """One number of the messages of a topic."""

    name: str  # as in `uuv/1/command.tau_0`
    topic: str
    field: str
    component: int | None  # of a field that holds several values
    unit: str
    absolute: bool = False

    def value(self, message: Any) -> float | None:
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
                if index is not None and component(field.name, index) in cls.DESCRIPTOR.fields_by_name:
                    continue  # a field of its own has this name
                whole = f"{channel.topic}.{field.name}"
                name = whole if index is None else component(whole, index)
                unit = each[(index or 0) % len(each)]
                self.by_name[name] = ChartSignal(name, channel.topic, field.name, index, unit)
                known = parse_name(name)
                if known is not None and known.vehicle is not None:
                    self.of_vehicles.setdefault(known.name, {})[known.vehicle] = name

    def of_all(self, name: str) -> dict[int, str]:
        """The names of a signal, of every vehicle that has it or of the one in the name; none: there is no such signal.
        `name`: such as `control.leader`, `command.tau_0`, `|error.e|` or `|uuv/3/error.e|`."""
        known = parse_name(name)
        if known is None:
            return {}
        every = str(known._replace(vehicle=None))
        if known.absolute and every not in self.of_vehicles:
            self._add_absolute(known.name)
        found = self.of_vehicles.get(every, {})
        return found if known.vehicle is None else {i: name for i, name in found.items() if i == known.vehicle}

    def _add_absolute(self, name: str) -> None:
        of_each = self.of_vehicles.get(name) or self.of_vehicles.get(component(name, 0)) or {}
        for i, signal_name in of_each.items():
            one = self.by_name[signal_name]
            whole = one if name in self.of_vehicles else one._replace(component=None)
            made = str(SignalName(name, True, i))
            self.by_name[made] = whole._replace(name=made, absolute=True)
            self.of_vehicles.setdefault(str(SignalName(name, True)), {})[i] = made

    def offers(self) -> dict[str, Any]:
        """The signals that can be shown, each with its unit. A signal of several vehicles also has its names.

        In the names of the latter a * stands for the number of the vehicle.
        """
        fleet = {}
        for name, each in self.of_vehicles.items():
            i, first = next(iter(each.items()))
            fleet[name] = [self.by_name[first].unit, first.replace(f"uuv/{i}/", "uuv/*/", 1)]
        return {"units": self.units, "fleet": fleet}

    def names_of(self, name: str) -> list[str]:
        """The names of one signal, or of a signal of all vehicles. Raises KeyError: there is no such signal."""
        names = [name] if name in self.by_name else list(self.of_all(name).values())
        if not names:
            raise KeyError(nearest(name, [*self.of_vehicles, *self.by_name]) or "the log has no such signal")
        return names

    @property
    def units(self) -> dict[str, str]:
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
        """The values of the followed signals in a message; empty if the message is damaged."""
        if not (some := self.followed.get(topic)):
            return
        try:
            message = decode_message(self._classes[topic], data)
        except DecodeError:
            return
        for signal in some:
            if (value := signal.value(message)) is not None:
                yield signal.name, value


def published_signals(topics: Mapping[str, PublishedTopic]) -> Signals:
    channels, schemas = [], {}
    for number, (topic, (name, descriptor_set, units)) in enumerate(topics.items(), start=1):
        channels.append(Channel(number, topic, "protobuf", {UNITS: units}, number))
        schemas[number] = Schema(number, descriptor_set, "protobuf", name)
    return Signals(channels, schemas)


def commands_of(vehicle: int) -> list[str]:
    """The names of what a vehicle's agent commands: surge force, pitch and yaw moment."""
    return [str(SignalName(component("command.tau", k), vehicle=vehicle)) for k in range(WIDTH)]
