"""The signals of a vehicle: how they are spelled, and what a log has of it, with units.

| name | what it is |
|---|---|
| `error.e_norm` | topic group, dot, field: the signal of every vehicle that has it |
| `command.tau_0` | the first component of a vector |
| `|error.e|` | the absolute value, of a vector its Euclidean norm |
| `uuv/3/command.tau_0`, `|uuv/3/error.e|` | the same of one vehicle; `uuv/*/` is every vehicle again |
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from math import hypot
from typing import NamedTuple

from agents.localization.localizer import Localizer
from agents.signals import HEARD, SignalLayout
from fleet.errors import FleetError
from netem.parsing import nearest
from world.navigation.config import Navigation, NavigationTrace
from world.signal import Signal, width_of

STATE = tuple(
    Signal(name, unit, meaning)
    for name, unit, meaning in (
        ("x", "m", "north"), ("y", "m", "east"), ("z", "m", "down"),
        ("theta", "rad", "pitch"), ("psi", "rad", "yaw, unwrapped"),
        ("u", "m/s", "surge over ground"), ("v", "m/s", "sway over ground"), ("w", "m/s", "heave over ground"),
        ("q", "rad/s", "pitch rate"), ("r", "rad/s", "yaw rate"),
    )
)  # fmt: skip
ROLL = (Signal("phi", "rad", "roll"), Signal("p", "rad/s", "roll rate"))  # a vehicle that rolls has them behind STATE
COMMAND = (
    Signal("tau", "N, N m, N m", "surge force, pitch and yaw moment as the agent commanded them", 3),
    Signal("applied", "N, N m, N m", "the same as the actuators applied them over the following tick", 3),
)
ERROR = (
    Signal("e", "m", "consensus error from true positions, NED", 3),
    Signal("e_norm", "m", "its Euclidean norm"),
    Signal("formation", "m", "true position minus desired position, NED", 3),
    Signal("formation_norm", "m", "its Euclidean norm"),
)
BELIEF = (
    Signal("sd", "m", "standard deviation of x, y, z as the vehicle believes it", 3),
    Signal("sd_psi", "rad", "standard deviation of psi as the vehicle believes it"),
    Signal("covariance", "1", "of x, y, z, psi [m, rad]: upper triangle, row by row", 10),
    Signal("off", "m", "believed minus true position, NED", 3),
    Signal("off_norm", "m", "its Euclidean norm"),
    Signal("nees", "1", "its normalised square; of a consistent filter chi-square with 3 degrees of freedom"),
    Signal("formation", "m", "believed position minus desired position, NED", 3),
    Signal("formation_norm", "m", "its Euclidean norm"),
)
LOCATED = (
    Signal("place", "m", "position by its navigator and by ranges, NED", 3),
    Signal("covariance", "m^2", "of its north and east: nn, ne, ee", 3),
    Signal("sd", "m", "standard deviation of north and east", 2),
    Signal("off", "m", "that position minus the true one, north and east", 2),
    Signal("off_norm", "m", "its Euclidean norm"),
    Signal("nees", "1", "its normalised square; of a consistent estimate chi-square with 2 degrees of freedom"),
)
CLOCK = (Signal("error", "s", "by how much its clock is ahead of simulated time"),)  # only if the clock is set
_ALWAYS = {"state": STATE, "nav": STATE, "command": COMMAND, "error": ERROR}
OF_THE_LAWS = ("guidance", "control")  # groups whose signals the laws of a vehicle declare
OF_THE_PLANT = "plant"  # the group whose signals the plant of a vehicle declares
OF_THE_CLOCK = "clock"
OF_NAVIGATION = "belief"  # the group of a vehicle that does not know where it is
OF_A_FILTER = frozenset(f"{OF_NAVIGATION}.{name}" for name in ("sd", "sd_psi", "covariance", "nees"))
OF_LOCALIZATION = "located"  # the group of a vehicle whose agent uses ranges
WHERE_LOCATED = slice(width_of(HEARD), width_of(HEARD) + 6)  # in the telemetry: position and covariance
GROUPS = (*_ALWAYS, OF_THE_CLOCK, OF_THE_PLANT, OF_NAVIGATION, OF_LOCALIZATION, *OF_THE_LAWS)

# A signal within a larger pattern, such as that of a measure; `read_name` makes a name of the match.
SIGNAL = r"(?P<bar>\|)?\s*(?:uuv/(?P<vehicle>\*|[1-9]\d{0,5})/)?(?P<name>[A-Za-z]\w*\.\w+)\s*(?(bar)\|)"
_GRAMMAR = re.compile(SIGNAL, re.ASCII)


class BeliefKind(IntEnum):
    """The kind of a vehicle's belief about its place. It determines which signals of `BELIEF` the vehicle has."""

    NONE = 0  # nothing: it knows where it is
    PLACE = 1  # where it is, and not how sure that is
    FILTER = 2  # both

    @classmethod
    def of(cls, navigation: Navigation | None) -> BeliefKind:
        """The belief of a vehicle that navigates so."""
        if navigation is None:
            return cls.NONE
        return cls.PLACE if isinstance(navigation, NavigationTrace) else cls.FILTER


class SignalError(FleetError):
    """A text names no signal of these vehicles."""

    def __init__(self, problem: str, hint: str = "") -> None:
        super().__init__(f"{problem}; {hint}" if hint else problem)
        self.problem = problem
        self.hint = hint


class SignalPlace(NamedTuple):
    """Where a signal is among the values of its topic group."""

    values: slice
    unit: str

    @property
    def width(self) -> int:
        """How many values it has."""
        return int(self.values.stop - self.values.start)


class SignalName(NamedTuple):
    """A signal, or the absolute value or norm of one."""

    name: str  # topic group, dot, field
    absolute: bool = False
    vehicle: int | None = None  # None: every vehicle that has it

    def __str__(self) -> str:
        text = self.name if self.vehicle is None else f"uuv/{self.vehicle}/{self.name}"
        return f"|{text}|" if self.absolute else text

    @property
    def group(self) -> str:
        """Its topic group."""
        return self.name.partition(".")[0]

    def value(self, values: Sequence[float]) -> float:
        """The number that its values come to; there is at least one."""
        return hypot(*values) if self.absolute else values[0]


def parse_name(text: str) -> SignalName | None:
    """The signal that a text such as `state.z` or `|uuv/3/error.e|` names; None: it is no such text."""
    found = _GRAMMAR.fullmatch(text.strip()) if len(text) <= 200 else None
    return None if found is None else read_name(found)


def read_name(found: re.Match[str]) -> SignalName:
    """The signal in a match of a pattern that contains `SIGNAL`."""
    vehicle = None if found["vehicle"] in (None, "*") else int(found["vehicle"])
    return SignalName(found["name"], found["bar"] is not None, vehicle)


def component(vector: str, k: int) -> str:
    """The name of component `k` of a vector, counted from 0."""
    return f"{vector}_{k}"


class VehicleSignals(NamedTuple):
    """The signals of one vehicle in a log."""

    layout: SignalLayout | None = None  # what its agent reports; None: that is not known
    plant: tuple[Signal, ...] | None = None  # what its plant reports; None: it has none
    has_clock: bool = False  # whether the clock of the vehicle is set
    belief: BeliefKind = BeliefKind.NONE  # what it believes of its place
    measured: bool = True  # whether its motion and its command are in the log; those of others' robots are not

    def groups(self) -> dict[str, tuple[int, tuple[Signal, ...]]]:
        """By topic group where its values begin, and its signals."""
        groups = {group: (0, signals) for group, signals in _ALWAYS.items()} if self.measured else {}
        if self.has_clock:
            groups[OF_THE_CLOCK] = 0, CLOCK
        if self.plant is not None:
            groups |= dict.fromkeys(("state", "nav"), (0, STATE + ROLL)) | {OF_THE_PLANT: (0, self.plant)}
        if self.belief is not BeliefKind.NONE:
            groups[OF_NAVIGATION] = 0, BELIEF
        if self.layout is not None:
            if locates(self.layout):
                groups[OF_LOCALIZATION] = 0, LOCATED
            groups |= {group: (self.layout.group(group).start, getattr(self.layout, group)) for group in OF_THE_LAWS}
        return groups

    def places(self) -> dict[str, SignalPlace]:
        """Every signal, vectors and their components, by name."""
        found: dict[str, SignalPlace] = {}
        for group, (start, signals) in self.groups().items():
            for signal in signals:
                name, width = f"{group}.{signal.name}", signal.width
                if name in OF_A_FILTER and self.belief is BeliefKind.PLACE:
                    start += width
                    continue
                units = signal.unit.split(", ") if ", " in signal.unit else [signal.unit] * width
                found[name] = SignalPlace(slice(start, start + width), signal.unit)
                if width > 1:
                    for k, unit in enumerate(units):
                        found.setdefault(component(name, k), SignalPlace(slice(start + k, start + k + 1), unit))
                start += width
        return found


def locates(layout: SignalLayout) -> bool:
    """Whether an agent with this layout reports where it is by ranges."""
    return layout.guidance[len(HEARD) :][:2] == Localizer.signals[:2]


def unit_of(signal: SignalName, vehicles: Iterable[Mapping[str, SignalPlace]]) -> str:
    """The unit of a signal, which some of these vehicles have; "1": it has none.

    `vehicles`: the signals of each. Raises SignalError: none has it, it has several values, or several units.
    """
    known: dict[str, int] = {}  # every name, and its width
    units: set[str] = set()
    for signals in vehicles:
        known |= {name: place.width for name, place in signals.items()}
        if signal.name in signals:
            units.add(signals[signal.name].unit)
    name = signal.name
    if not units:
        raise SignalError(f"there is no signal {name}", _hint(name, known))
    if (width := known[name]) > 1 and not signal.absolute:
        raise SignalError(
            f"{name} has {width} values: choose {component(name, 0)} to {component(name, width - 1)}, or |{name}|"
        )
    unit = ", ".join(sorted(units))
    if len(units) > 1 or ", " in unit:
        raise SignalError(f"{name} has several units, {unit}: choose one")
    return unit


def _hint(name: str, known: Mapping[str, int]) -> str:
    if re.sub(r"_\d+$", "", name) in OF_A_FILTER:
        return "vehicles with dead reckoning have it, and those with a trace do not know how sure they are"
    group, _, field = name.partition(".")
    beside = [other.partition(".")[2] for other in known if other.startswith(f"{group}.")]
    if not beside:
        return nearest(name, known) or f"there are {', '.join(dict.fromkeys(n.partition('.')[0] for n in known))}"
    return nearest(field, beside).replace('"', f'"{group}.', 1) or f"{group} has {', '.join(beside)}"
