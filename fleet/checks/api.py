"""The interface of your own checks in Python: the input of a check, and the values that it returns.

A check is a class, made once per run as `Check(facts, **parameters)`: what it may know of the scenario, and the
parameters that the scenario gives it. It has

* `step(tick)`: called at every tick with samples in the log. It returns None, or a `Failure` if the property is
  broken at that tick. The first failure decides; after it the check is not called any more.
* `verdict()`, which is optional: called at the end. During a run it is called as if the run ended now, so it must
  change nothing. It returns None, a text about its findings, a `Failure` if only the end can show it, or `NotJudged`
  if the run ended too early to tell.
* `margin()`, which is optional: the least distance so far from breaking the property, as a `Margin` with value, unit
  and time [s]. It is negative once the property is broken, and None if the check does not know it.

`docs/guide/your-checks.md` is the guide; `fleet new check NAME` writes a template.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from fleet.quantities import time_ns, vehicle_name, vehicle_names
from fleet.quantities import vehicle_numbers as vehicle_numbers
from fleet.result.verdict import Margin as Margin

__all__ = [
    "Check",
    "Facts",
    "Failure",
    "Fault",
    "Margin",
    "NotJudged",
    "Packet",
    "Tick",
    "Vehicle",
    "seconds",
    "vehicle_numbers",
]


class Fault(NamedTuple):
    """A fault that is active."""

    id: str
    what: str  # in the words of a scenario: kill 3
    since: float  # s
    entry: str = ""  # as data, in JSON: {"kill": "3"}


class Facts(NamedTuple):
    """The facts about the scenario that a check gets."""

    scenario: str  # name of the scenario
    seed: int
    vehicles: int  # how many; their numbers are 1 to this one
    duration: float  # s
    tick: float  # length of a tick [s]
    begin: float  # where the run begins [s]: 0, or the moment from which it goes on
    links: tuple[tuple[int, int], ...]  # directed: sender, receiver
    units: Mapping[int, Mapping[str, str]]  # by vehicle and signal, "1" of one without
    names: tuple[str, ...] = ()  # of nodes, in the order of their numbers; (): vehicles are called by their numbers

    def name(self, vehicle: int) -> str:
        """How messages call a vehicle.

        Args:
            vehicle: its number, 1 to `vehicles`.

        Returns:
            The name of a node, or the number.
        """
        return vehicle_name(vehicle, self.names)

    def called(self, vehicles: Sequence[int]) -> str:
        """How a sentence calls some vehicles.

        Args:
            vehicles: their numbers, at least one.

        Returns:
            `vehicle 3`, `vehicles 3, 4`, or the names of nodes. Of more than eight, eight and how many more.
        """
        return vehicle_names(vehicles, self.names)


class Packet(NamedTuple):
    """A packet whose fate has become final; times in s."""

    src: int
    dst: int
    sent: float
    at: float  # when its fate became final
    fate: str  # delivered, in flight, or the cause of the loss
    corrupted: bool
    payload: bytes


class Vehicle(Protocol):
    """One vehicle at one tick."""

    @property
    def id(self) -> int: ...

    @property
    def alive(self) -> bool:
        """Whether it has an agent that no fault has ended, and has not diverged."""

    def __getitem__(self, signal: str) -> Any:
        """The value of a signal, in its unit of the log.

        Args:
            signal: its name, such as `state.z` or `control.e`.

        Returns:
            A number, of a vector a tuple of them; None if the vehicle did not report it at this tick.

        Raises:
            LookupError: no such signal.
        """


class Tick(NamedTuple):
    """All that is known at one tick."""

    tick: int
    t: float  # s
    vehicles: tuple[Vehicle, ...]  # all, by number
    faults: tuple[Fault, ...]  # the active ones
    packets: tuple[Packet, ...]  # packets whose fate has become final since the step before


class Failure(NamedTuple):
    """The property is broken."""

    message: str  # what is wrong, in one line
    vehicles: tuple[int, ...] = ()  # the vehicles at fault
    values: Mapping[str, float] = {}  # what shows it, by name


class NotJudged(NamedTuple):
    """What `verdict` of a check returns if the run ended too early to tell: the check neither passes nor fails."""

    message: str  # why, in one line


class Check(Protocol):
    """A check; `verdict` and `margin` may be left out."""

    def step(self, tick: Tick) -> Failure | None:
        """Look at a tick with samples in the log; the ticks come in their order.

        Args:
            tick: all that is known at this tick.

        Returns:
            How the property is broken; None: it holds so far. After the first failure there is no further call.
        """


def seconds(time: Any) -> float:
    """A time that is a parameter of a check.

    Args:
        time: a text such as "2 s" or "50 ms".

    Returns:
        The time in s.

    Raises:
        fleet.quantities.QuantityError: it is no time.
    """
    return time_ns(time) / 1e9
