"""The begin and the end of each fault in a log, and of each event of a vehicle."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

from fleet.logs.reader import LogReadError
from fleet.logs.topic import Topic
from fleet.quantities import QuantityError, vehicle_numbers
from netem.limits import LOG_FAULTS


def kind_and_vehicles(what: str) -> tuple[str, Sequence[int]]:
    """The kind of a fault, and the vehicles that its words name, as in `kill 3`; none if they name something else."""
    kind, _, who = what.partition(" ")
    try:
        return kind, vehicle_numbers(who)
    except QuantityError:
        return kind, ()


class FaultInterval(NamedTuple):
    """A fault of the log, and when it was active, in s of simulated time.

    A fault whose end is not in the log lasts to the end of the log.
    """

    id: str  # as in the scenario, or f1, f2, ...
    begin: float  # [s]
    end: float  # [s]
    what: str  # kind and arguments, such as `kill 3`


class FaultTime(Struct, frozen=True):
    """The same fault as `--json` prints it."""

    id: str
    from_s: float
    to_s: Annotated[float, Meta(description="When it ends, at the latest with the run or the log.")]
    what: Annotated[str, Meta(description="What it does, as a scenario writes it.")]


def fault_intervals(topic: Topic, end: float) -> list[FaultInterval]:
    """Faults and events of vehicles, in the order of their beginnings, from a message for each begin and each end. One
    without an end lasts to `end` of the log [s]. Raises LogReadError for more than LOG_FAULTS.items messages.
    """
    if len(topic) > LOG_FAULTS.items:
        raise LogReadError(
            f"the log holds {len(topic)} events of faults, more than the {LOG_FAULTS.items} that are read"
        )
    if not len(topic):
        return []
    return intervals(zip(topic.t, topic["fault"], topic["action"], topic["what"], strict=True), end)


def intervals(happened: Iterable[tuple[float, str, str, str]], end: float) -> list[FaultInterval]:
    """As `fault_intervals`, from time [s], id, `begins` or `ends`, kind and arguments of each message."""
    found: dict[str, FaultInterval] = {}
    for at, name, action, what in happened:
        if action == "begins":
            found[name] = FaultInterval(name, float(at), end, what)
        elif name in found:
            found[name] = found[name]._replace(end=float(at))
    return list(found.values())
