"""Faults of the network with a beginning and an end: what holds for every link at a tick.

A fault never changes a link's own condition; it lies over it while it lasts, the later begun over the earlier. So every
fault heals by ending, and faults that overlap need no order of ending.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
from msgspec import structs

from netem.cause import Cause
from netem.condition import Condition, Link, condition_from_values, condition_values
from netem.errors import MalformedMessage
from netem.fault_kinds import NetFaultKind
from netem.wire.messages import TimedFault


class NetFault(TimedFault, frozen=True):
    """A fault of the network."""

    kind: NetFaultKind
    links: tuple[Link, ...] = ()  # links of a link, down, up, partition, hold or duplicate
    vehicles: tuple[int, ...] = ()  # vehicles of a mute, deaf, slow or clock
    condition: Condition | None = None  # condition of a link
    ticks: int = 0  # slow: how late packets are; duplicate: how much later the copy comes
    values: tuple[float, ...] = ()  # clock: step [s] and drift [s/s]; hold: 1 if the order is reversed


_CONDITION = NetFault.__struct_fields__.index("condition")


def fault_values(fault: NetFault) -> list[Any]:
    """A fault as plain values, with its condition as `condition_values` writes it."""
    values: list[Any] = msgspec.to_builtins(structs.replace(fault, condition=None))
    if fault.condition is not None:
        values[_CONDITION] = condition_values(fault.condition)
    return values


def fault_from_values(values: list[Any]) -> NetFault:
    """The inverse of `fault_values`. Raises msgspec.ValidationError: a value does not have the type that is declared
    for it."""
    plain = [*values]
    condition = None
    if len(plain) > _CONDITION and plain[_CONDITION] is not None:
        condition = condition_from_values(msgspec.convert(plain[_CONDITION], dict[str, Any]))
        plain[_CONDITION] = None
    return structs.replace(msgspec.convert(plain, NetFault), condition=condition)


def read_faults(values: Any) -> tuple[NetFault, ...]:
    """Faults from the plain values of a request. Raises MalformedMessage: they are no such values."""
    try:
        faults = tuple(fault_from_values(fault) for fault in msgspec.convert(values, list[list[Any]]))
    except msgspec.ValidationError as error:
        raise MalformedMessage("control", f"expected faults: {error!s:.150}") from None
    for fault in faults:
        if fault.kind == "link" and fault.condition is None:
            raise MalformedMessage("control", f"the fault {fault.id!r:.40} of a link has no condition")
        if fault.kind == "clock" and len(fault.values) != 2:
            raise MalformedMessage("control", f"the fault {fault.id!r:.40} of a clock has no step and drift")
    return faults


class ActiveFaults(NamedTuple):
    """The combined effect of the faults that are active at a tick."""

    conditions: dict[Link, Condition]  # conditions in place of the links' own
    cut: dict[Link, Cause]  # links that lose everything, with the cause
    mute: frozenset[int]
    deaf: frozenset[int]
    up: frozenset[Link]  # links that are up whatever their own condition says
    slow: dict[int, int]  # vehicle -> by how many ticks what it sends is late
    hold: dict[Link, bool]  # links whose packets are kept; true: the last one comes first
    again: dict[Link, int]  # how many ticks later a copy of each packet comes


NO_FAULTS = ActiveFaults({}, {}, frozenset(), frozenset(), frozenset(), {}, {}, {})


def active_faults(faults: tuple[NetFault, ...], tick: int) -> ActiveFaults:
    """Add up the faults that are active at a tick. If two contradict each other, the later one applies.

    Args:
        faults: all faults, ordered by their begin.
        tick: of simulated time.

    Returns:
        Their joint effect.
    """
    active = [fault for fault in faults if fault.active(tick)]
    if not active:
        return NO_FAULTS
    conditions: dict[Link, Condition] = {}
    cut: dict[Link, Cause] = {}
    mute: set[int] = set()
    deaf: set[int] = set()
    up: set[Link] = set()
    slow: dict[int, int] = {}
    hold: dict[Link, bool] = {}
    again: dict[Link, int] = {}
    for fault in active:
        match fault.kind:
            case "link":
                assert fault.condition is not None
                conditions |= dict.fromkeys(fault.links, fault.condition)
            case "down" | "partition":
                cut |= dict.fromkeys(fault.links, Cause(fault.kind))
                up -= set(fault.links)
            case "up":
                cut = {link: cause for link, cause in cut.items() if cause != Cause.DOWN or link not in fault.links}
                up |= set(fault.links)
            case "slow":
                slow |= {i: max(fault.ticks, slow.get(i, 0)) for i in fault.vehicles}
            case "hold":
                hold |= dict.fromkeys(fault.links, bool(fault.values))
            case "duplicate":
                again |= dict.fromkeys(fault.links, fault.ticks)
            case "mute":
                mute.update(fault.vehicles)
            case "deaf":
                deaf.update(fault.vehicles)
    return ActiveFaults(conditions, cut, frozenset(mute), frozenset(deaf), frozenset(up), slow, hold, again)


def release_tick(faults: tuple[NetFault, ...], link: Link, tick: int) -> int | None:
    """Look when the packets of a link go on.

    Args:
        faults: all faults, ordered by their begin.
        link: that holds its packets.
        tick: from which on.

    Returns:
        The first tick at which no fault holds packets of the link; None: a fault lasts to the end.
    """
    holds = [fault for fault in faults if fault.kind == "hold" and link in fault.links]
    while over := [fault.end for fault in holds if fault.active(tick)]:
        if None in over:
            return None
        tick = max(end for end in over if end is not None)
    return tick
