"""The checks that a run must pass."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, PlainSerializer

from fleet.scenario.schema.section import Section
from fleet.scenario.schema.value_types import Count, LinkSelector, Period, PositiveLength, Time, VehicleNumbers


class Below(Section):
    """The largest value over all vehicles, or those named, stays below a limit from a time to the end."""

    below: PositiveLength
    after: Time = 0
    vehicles: VehicleNumbers | None = None


class AtMost(Section):
    """A count stays within a limit."""

    at_most: Count


WAIVED = "waived"


class Standing(AtMost):
    """A check that every scenario has, with at most 0, unless the file gives another limit or waives it."""

    at_most: Count = 0
    waived: bool = False  # `tumbled: waived` in the file


class Tumbled(Standing):
    """How often vehicles, all or those named, may tumble: pitch beyond `vehicle.tumble_pitch`."""

    vehicles: VehicleNumbers | None = None


def _standing(value: Any) -> Any:
    return {"waived": True} if value == WAIVED else value


def _show_standing(check: Standing | None) -> Any:
    if check is None or check.waived:
        return None if check is None else WAIVED
    return check.model_dump(exclude={"waived"}, exclude_none=True)


class MaxAge(Section):
    """The age of the last message that was delivered stays below a limit on some links, from a time to the end."""

    below: Period
    after: Time = 0
    links: LinkSelector = "*"


EVERY = "every"  # in place of a fault's id: each fault that ends before the run


class Recovery(Section):
    """After a fault has ended, an error comes below `within` in less than `below`, and stays there.

    It stays until the next fault begins, or to the end.
    """

    fault: str  # its id: as given, or f1, f2, ...; or EVERY
    below: Period
    within: PositiveLength
    error: Literal["formation", "consensus"] = "formation"
    vehicles: VehicleNumbers | None = None


class MinSeparation(Section):
    """The distance of any two vehicles, of all or of those named, stays above a limit from a time to the end."""

    above: PositiveLength
    after: Time = 0
    vehicles: VehicleNumbers | None = None


class Connected(Section):
    """The messages delivered within every window of some length connect each vehicle with the reference."""

    window: Period
    after: Time = 0  # when the first window begins
    vehicles: VehicleNumbers | None = None  # the vehicles that must be connected; all


def _recoveries(value: Any) -> Any:
    """A single check may be given without the list."""
    if isinstance(value, dict):
        return [value]
    return None if value == [] else value


def _show_recoveries(recoveries: list[Recovery] | None) -> Any:
    shown = [entry.model_dump(exclude_none=True) for entry in recoveries or ()]
    return shown[0] if len(shown) == 1 else shown or None


class ChecksSection(Section):
    """The checks that decide whether a run passes; `tumbled` and `deaths` are checked by default."""

    formation_error: Below | None = None  # |eta_i - eta_i^d|
    consensus_error: Below | None = None  # |e_i| from true positions
    recovery_time: Annotated[list[Recovery] | None, BeforeValidator(_recoveries), PlainSerializer(_show_recoveries)] = (
        None
    )
    min_separation: MinSeparation | None = None
    max_age: MaxAge | None = None
    connected: Connected | None = None
    tumbled: Annotated[Tumbled | None, BeforeValidator(_standing), PlainSerializer(_show_standing)] = None
    deaths: Annotated[Standing | None, BeforeValidator(_standing), PlainSerializer(_show_standing)] = None
    qp_infeasible: AtMost | None = None
    ledger: Literal["balanced"] | None = None
    middleware_loss: AtMost | None = None
