"""Faults at given times, and faults that begin when an agent reports something."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, create_model

from fleet.scenario import value_types as v
from fleet.scenario.faults.kind import FaultKind
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.faults.of_motion import CurrentSection, CurrentValue
from fleet.scenario.schema.checks import OnlyTrue, Quantity
from fleet.scenario.value_types import Section


class SeaSection(Section):
    """The forces of the sea on every vehicle."""

    disturbance: Literal["none", "paper"] = "none"
    current: CurrentValue = CurrentSection.model_construct()


FaultId = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")]


class FaultTimes(Section):
    """When a fault begins, and for how long it lasts. It always ends, at the latest with the run."""

    id: FaultId | None = None  # f1, f2, ...
    at: v.Time
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # to the end


ACTIONS = tuple(KINDS)
_FIELDS: dict[str, Any] = {name: (kind.value | None, None) for name, kind in KINDS.items()}
_Effect: Any = create_model("_Effect", __base__=Section, **_FIELDS)


class FaultAction(_Effect):
    """The effect of a fault: the entry gives exactly one of these keys, each the name of a kind."""

    @property
    def kind(self) -> FaultKind:
        """The kind of a valid fault."""
        return next(kind for name, kind in KINDS.items() if getattr(self, name) is not None)

    @property
    def values(self) -> Any:
        """What a valid fault has behind the name of its kind."""
        return getattr(self, self.kind.name)


class FaultSection(FaultAction, FaultTimes):
    """One fault."""


def read_fault(value: Any) -> Any:
    """`link 1->2: loss 30%` is short for `link: {1->2: loss 30%}`."""
    if not isinstance(value, dict):
        return value
    long: dict[str, Any] = {}
    for key, inner in value.items():
        if isinstance(key, str) and key.startswith("link ") and "link" not in value:
            long.setdefault("link", {})[key.removeprefix("link ").strip(" \"'")] = inner
        else:
            long[key] = inner
    return long


FaultEntry = Annotated[FaultSection, BeforeValidator(read_fault)]


class WhenSection(Section):
    """A moment in what agents report: one condition begins to hold, or a value changes.

    A condition that holds in the first sample begins there.
    """

    topic: str  # topic group, dot, field: control.leads
    vehicles: v.VehicleNumbers | None = None  # the vehicles whose reports count; default: all
    above: Quantity | None = None
    below: Quantity | None = None
    equals: Quantity | None = None
    changes: OnlyTrue = None
    after: v.Time = 0  # earlier samples do not count
    before: v.Period | None = None  # samples from then on do not count; default: the end


class TriggerSection(Section):
    """A fault that begins some time after such a moment; at most once in a run."""

    id: FaultId | None = None  # t1, t2, ...
    when: WhenSection
    nth: Annotated[int, Field(ge=1)] = 1  # the number of the moment, in the order of time and vehicles
    wait: v.Period | None = None  # from the moment on; a round, which is also the least
    for_: Annotated[v.Period | None, Field(alias="for")] = None  # to the end
    fault: dict[str, Any]  # as in `faults`; itself, others and neighbours stand for numbers
