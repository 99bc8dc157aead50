"""A kind of fault: all that is particular to it, in one class."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Any, ClassVar, Literal, NamedTuple, cast

from fleet.quantities import vehicle_numbers
from fleet.scenario import value_types as v
from fleet.scenario.value_types import Section, section_of
from netem.condition import Link
from netem.fault_kinds import NetFaultKind, WorldFaultKind
from netem.faults import NetFault
from netem.link_selector import parse_selector, select
from netem.lives import Absence
from netem.wire.messages import TimedFault, WorldFault


class Kill(TimedFault, frozen=True):
    """Agents that end at tick `begin` and, unless `end` is None, are started again at tick `end`."""

    vehicles: tuple[int, ...]
    kind: str = "kill"

    @property
    def absences(self) -> list[Absence]:
        return [Absence(i, self.begin, self.end) for i in self.vehicles]


Part = NetFault | WorldFault | Kill  # what one core does during a fault


class Surroundings(NamedTuple):
    """What a fault has to know of its run."""

    vehicles: int
    seed: int
    links: tuple[Link, ...]
    tick_ns: int = 1
    round_ticks: int = 1
    ticks: int = 1  # length of the run

    def links_named(self, selector: str) -> tuple[Link, ...]:
        """The links of the graph that a selector names."""
        return select(parse_selector(selector), self.links)


class Strength(NamedTuple):
    """What a nemesis draws for a fault beside its target."""

    size: float  # 0 is mild, 1 is strong
    turn: float  # 0 to 1: a sign, a direction, or one of two forms
    round_ns: int
    tick_ns: int
    lasts_ns: int

    def between(self, low: float, high: float) -> float:
        """The value at this strength, on a logarithmic scale and rounded to three digits."""
        return interpolate(low, high, self.size)

    @property
    def later_ns(self) -> int:
        """A time [ns] from a fifth of a round to 50 rounds, in whole ticks."""
        late = round(self.between(0.2, 50.0) * self.round_ns)
        return max(self.tick_ns, late // self.tick_ns * self.tick_ns)


def interpolate(low: float, high: float, strength: float) -> float:
    """The value at `strength` (0 to 1) between `low` and `high` on a logarithmic scale, rounded to three digits."""
    return float(f"{low * (high / low) ** strength:.3g}")


def network_fault(
    times: TimedFault, effect: str, links: Sequence[Link] = (), vehicles: Sequence[int] = (), **more: Any
) -> NetFault:
    """What the network does during a fault."""
    kind = cast("NetFaultKind", effect)
    return NetFault(times.id, times.begin, times.end, kind, tuple(links), tuple(vehicles), **more)


def world_fault(
    times: TimedFault, effect: WorldFaultKind, vehicles: Sequence[int], numbers: Sequence[float]
) -> WorldFault:
    """What the world does during a fault."""
    return WorldFault(times.id, times.begin, times.end, effect, tuple(vehicles), tuple(numbers))


def plane(size: float, angle: float, rest: str) -> str:
    """A vector in the plane as a scenario writes it; `rest` is its depth and unit."""
    return f"{size * cos(angle):.3f} {size * sin(angle):.3f}{rest}"


class FaultKind:
    """A kind of fault. Schema, grammar, completion, page, rules, nemesis and `fleet shrink` read its attributes.

    A kind is one class: its base says what it concerns (`LinkFaultKind`, `VehicleFaultKind`, `FleetFaultKind`), its
    methods what it does there, and `fleet.scenario.faults.kinds` names it. `values` are always those behind its name in
    a scenario.
    """

    value: ClassVar[Any]  # the type of what a scenario has behind its name
    example: ClassVar[str]  # in words
    # What it acts on. Other people's robots have faults of the network alone, and these act at round ticks only. With
    # an ideal network there are no faults of the network and none of agents.
    acts_on: ClassVar[Literal["network", "agent", "vehicle"]] = "vehicle"
    one_word: ClassVar[bool] = False  # keys may be left out, since one key stands for all
    in_water: ClassVar[bool] = True  # whether an acoustic channel has it
    every_number_strengthens: ClassVar[bool] = False  # so `fleet shrink` tries smaller ones
    drawn: ClassVar[Literal["", "target", "strength"]] = ""  # what a nemesis draws of it; "" is never drawn
    needs: ClassVar[Literal["", "clock", "dead reckoning", "fixes"]] = ""  # vehicles without it do not notice
    silences: ClassVar[bool] = False  # a vehicle speaks again after it
    holds_command: ClassVar[bool] = False  # a vehicle goes on with its last command, and may tumble with any protocol
    shown: ClassVar[str] = ""  # beside a vehicle on the page, while it lasts
    offers: ClassVar[tuple[tuple[str, str], ...]] = ()  # the buttons of the page: name and words, {0} for the target

    @property
    def name(self) -> str:
        """Its key in a scenario."""
        return type(self).__name__.removesuffix("Fault").lower()

    @property
    def section(self) -> type[Section] | None:
        """The keys that it has. None: it is written in one word."""
        return section_of(self.value)

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        """What each core does. Raises TextError: it cannot be done in this fleet."""
        raise NotImplementedError

    def does_nothing(self, values: Any) -> bool:
        """Whether the values are those of no fault."""
        return False

    def times(self, values: Any) -> list[int]:
        """Those of its times that are whole numbers of ticks [ns]."""
        return []

    def vehicles(self, values: Any) -> tuple[int, ...]:
        """The vehicles that it names; none if it concerns all, or links."""
        return ()

    def selectors(self, values: Any) -> list[str]:
        """The links that it names."""
        return []

    def of_strength(self, target: str, strength: Strength) -> Any:
        """A drawn fault of a target, as a scenario writes it."""
        return target


class LinkFaultKind(FaultKind):
    """It concerns the links that a selector names."""

    acts_on = "network"
    value: ClassVar[Any] = v.LinkSelector

    def selectors(self, values: Any) -> list[str]:
        return [values if isinstance(values, str) else values.links]

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        return [network_fault(times, self.name, around.links_named(self.selectors(values)[0]))]


class VehicleFaultKind(FaultKind):
    """It concerns some vehicles, or all of them: by the number of each effect that the world has for it."""

    value: ClassVar[Any] = v.VehicleNumbers

    def vehicles(self, values: Any) -> tuple[int, ...]:
        text = values if isinstance(values, str) else values.vehicles
        return () if text is None else tuple(vehicle_numbers(text))

    def numbers(self, values: Any) -> tuple[float, ...]:
        """What the world gets to know, in the order of `WorldFaultKind`: mostly the values of its keys in theirs."""
        if not isinstance(values, Section):
            return ()
        each = [value if isinstance(value, tuple) else (value,) for key, value in values if key != "vehicles"]
        return tuple(number for some in each for number in some)

    def does_nothing(self, values: Any) -> bool:
        return bool(numbers := self.numbers(values)) and not any(numbers)

    def parts(self, values: Any, times: TimedFault, around: Surroundings) -> list[Part]:
        who, effect = self.vehicles(values), WorldFaultKind(self.name)
        return [world_fault(times, effect, who, self.numbers(values))]

    def of_strength(self, target: str, strength: Strength) -> Any:
        values = self.values_of_strength(strength)
        return {"vehicles": target} | values if values else target

    def values_of_strength(self, strength: Strength) -> dict[str, str]:
        """The values of a drawn fault, but for its vehicles; nothing: there are none to draw."""
        return {}


class FleetFaultKind(VehicleFaultKind):
    """It concerns all vehicles, and names none."""

    def vehicles(self, values: Any) -> tuple[int, ...]:
        return ()


class SomeVehicles(Section):
    """The values of a fault of some vehicles, or of all."""

    vehicles: v.VehicleNumbers | None = None
