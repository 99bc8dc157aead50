"""The entry of a fault: what a scenario has in its list of `faults`, without id and times, as JSON.

It goes with the words of a fault into events. The words are for people, and have the names of nodes; the entry is for
programs, and has the numbers of vehicles. So nobody reads the words again but `fleet.logs.fault_intervals`, for a log
has the words alone. What befell a vehicle has an entry, too, such as `{"tumbled": "3"}`, though no scenario may ask for
it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from fleet.quantities import QuantityError, vehicle_numbers
from fleet.scenario.schema.faults import FaultAction
from fleet.scenario.sections.node_names import to_names

TUMBLED, DIVERGED = "tumbled", "diverged"  # what befalls vehicles


def entry_of(fault: FaultAction) -> str:
    """The entry of a valid fault."""
    name = fault.kind.name
    return json.dumps({name: fault.model_dump(exclude_none=True, exclude_defaults=True)[name]})


def vehicle_entry(kind: str, i: int) -> str:
    """The entry of a fault of one vehicle, or of what befell it."""
    return json.dumps({kind: str(i)})


def words_of(entry: str, names: Sequence[str] = ()) -> str:
    """A fault as a scenario writes it. `names`: of the nodes, if it has some."""
    kind, value = next(iter(values_of(entry).items()))
    if kind == "link":
        return "link " + ", ".join(f"{to_names(selector, names)}: {condition}" for selector, condition in value.items())
    if isinstance(value, dict):
        return f"{kind} {{{', '.join(f'{key}: {inner}' for key, inner in value.items())}}}"
    return f"{kind} {to_names(value, names)}"


def values_of(entry: str) -> dict[str, Any]:
    """An entry as plain values; {} of no entry."""
    found: dict[str, Any] = json.loads(entry) if entry else {}
    return found


def fault_of(entry: str) -> FaultAction | None:
    """The fault of an entry; None: it is none."""
    try:
        return fault_reader().validate_python(values_of(entry)) if entry else None
    except ValidationError:
        return None


@lru_cache(4096)
def entry_kind(entry: str) -> str:
    """The kind of a fault, or what befell a vehicle; "" of no entry."""
    return next(iter(values_of(entry)), "")


@lru_cache(4096)
def entry_vehicles(entry: str) -> tuple[int, ...]:
    """The vehicles that an entry names; none if it concerns all, or links."""
    if is_fault(entry):
        fault = fault_of(entry)
        return () if fault is None else fault.kind.vehicles(fault.values)
    try:
        return tuple(vehicle_numbers(values_of(entry)[entry_kind(entry)]))
    except (QuantityError, TypeError):
        return ()


def is_fault(entry: str) -> bool:
    """Whether it is a fault, and not what befell a vehicle, which is the consequence of one."""
    return entry_kind(entry) not in (TUMBLED, DIVERGED)


@lru_cache(1)  # many runs need none, and it takes time to build
def fault_reader() -> TypeAdapter[FaultAction]:
    """Reads a fault without times from plain values."""
    return TypeAdapter(FaultAction)
