"""Faults of the network with a beginning and an end: what holds for every link at a tick.

A fault never changes a link's own condition; it lies over it while it lasts, the later begun over the earlier. So every
fault heals by ending, and faults that overlap need no order of ending.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, NamedTuple, get_type_hints

import msgspec

from netem.condition import Condition, Link, condition_from_values, condition_values
from netem.errors import MalformedMessage

FaultKind = Literal["link", "down", "up", "partition", "mute", "deaf", "slow"]


@dataclass(frozen=True, slots=True)
class NetFault:
    """One fault: from tick `begin` to before `end` (None: to the end of the run)."""

    id: str
    begin: int
    end: int | None
    kind: FaultKind
    links: tuple[Link, ...] = ()  # of link, down, up, partition
    vehicles: tuple[int, ...] = ()  # of mute, deaf, slow
    condition: Condition | None = None  # of link
    ticks: int = 0  # of slow: how late

    def active(self, tick: int) -> bool:
        """Whether it holds at a tick."""
        return self.begin <= tick and (self.end is None or tick < self.end)


def fault_values(fault: NetFault) -> list[Any]:
    """A fault as plain values."""
    condition = None if fault.condition is None else condition_values(fault.condition)
    links = [list(link) for link in fault.links]
    return [fault.id, fault.begin, fault.end, fault.kind, links, list(fault.vehicles), condition, fault.ticks]


def fault_from_values(values: list[Any]) -> NetFault:
    """The inverse of `fault_values`."""
    name, begin, end, kind, links, vehicles, condition, ticks = values
    return NetFault(
        name,
        begin,
        end,
        kind,
        tuple((src, dst) for src, dst in links),
        tuple(vehicles),
        None if condition is None else condition_from_values(condition),
        ticks,
    )


_FAULT = tuple[str, int, int | None, FaultKind, list[tuple[int, int]], list[int], dict[str, Any] | None, int]


def read_faults(values: Any) -> tuple[NetFault, ...]:
    """Faults from the plain values that somebody sent.

    Raises:
        MalformedMessage: they are no such values.
    """
    try:
        faults = [fault_from_values(list(fault)) for fault in msgspec.convert(values, list[_FAULT])]
        for fault in faults:
            if fault.condition is not None:
                _check(fault.condition)
            elif fault.kind == "link":
                raise MalformedMessage("control", f"the fault {fault.id!r:.40} of a link has no condition")
    except (msgspec.ValidationError, LookupError, TypeError) as error:
        raise MalformedMessage("control", f"expected faults: {error!s:.150}") from None
    return tuple(faults)


# Without the loss model: msgspec cannot tell two data classes apart.
_CONDITION = msgspec.defstruct(
    "Condition", [(name, kind) for name, kind in get_type_hints(Condition).items() if name != "loss_model"]
)


def _check(condition: Condition) -> None:
    """Raise msgspec's ValidationError unless every value has the type that is declared for it."""
    msgspec.convert({k: v for k, v in condition_values(condition).items() if k != "loss_model"}, _CONDITION)
    if (model := condition.loss_model) is not None:
        msgspec.convert(asdict(model), type(model))


class ActiveFaults(NamedTuple):
    """What the faults that are active at a tick do."""

    conditions: dict[Link, Condition]  # in place of the link's own
    cut: dict[Link, str]  # links that lose everything, with the cause
    mute: frozenset[int]
    deaf: frozenset[int]
    up: frozenset[Link]  # links that are up whatever their own condition says
    slow: dict[int, int]  # vehicle -> by how many ticks what it sends is late


NO_FAULTS = ActiveFaults({}, {}, frozenset(), frozenset(), frozenset(), {})


def active_faults(faults: tuple[NetFault, ...], tick: int) -> ActiveFaults:
    """What holds at a tick; `faults` in the order in which they begin."""
    active = [fault for fault in faults if fault.active(tick)]
    if not active:
        return NO_FAULTS
    conditions: dict[Link, Condition] = {}
    cut: dict[Link, str] = {}
    mute: set[int] = set()
    deaf: set[int] = set()
    up: set[Link] = set()
    slow: dict[int, int] = {}
    for fault in active:
        match fault.kind:
            case "link":
                assert fault.condition is not None
                conditions |= dict.fromkeys(fault.links, fault.condition)
            case "down" | "partition":
                cut |= dict.fromkeys(fault.links, fault.kind)
                up -= set(fault.links)
            case "up":
                cut = {link: cause for link, cause in cut.items() if cause != "down" or link not in fault.links}
                up |= set(fault.links)
            case "slow":
                slow |= {i: max(fault.ticks, slow.get(i, 0)) for i in fault.vehicles}
            case "mute":
                mute.update(fault.vehicles)
            case "deaf":
                deaf.update(fault.vehicles)
    return ActiveFaults(conditions, cut, frozenset(mute), frozenset(deaf), frozenset(up), slow)
