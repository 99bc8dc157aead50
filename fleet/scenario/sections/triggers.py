"""Triggers: faults that begin when an agent reports something, such as that it leads.

A trigger becomes an ordinary fault when an agent has made the report that it waits for.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from pydantic import TypeAdapter

from fleet.quantities import show_time
from fleet.scenario.schema.checks import SignalCheck
from fleet.scenario.schema.faults import FaultEntry, FaultSection, TriggerSection, WhenSection
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.sections.signal_checks import SignalCheckError, SignalCondition, ask, find_signal
from fleet.scenario.sections.signals import SignalName, SignalPlace

RELATIVE = ("itself", "others", "neighbours")  # seen from the agent that reports
_RELATIVE = re.compile(rf"\b({'|'.join(RELATIVE)})\b")


@cache  # most runs need none, and it takes 20 ms
def _entry() -> TypeAdapter[FaultSection]:
    return TypeAdapter(FaultEntry)


def read_entry(values: Mapping[str, Any]) -> FaultSection:
    """Read an entry of `faults`. Raises pydantic.ValidationError: it is none."""
    return _entry().validate_python(values)


class AskedMoment(NamedTuple):
    """The moment that a trigger waits for, in SI units."""

    signal: SignalName
    vehicles: tuple[int, ...]
    condition: SignalCondition | None  # None: any change


def ask_moment(when: WhenSection, vehicles: Mapping[int, Mapping[str, SignalPlace]]) -> AskedMoment:
    """The moment in SI units; `vehicles`: the signals of each. Raises SignalCheckError: it makes no sense."""
    given = [key for key in ("above", "below", "equals", "changes") if getattr(when, key) is not None]
    if len(given) != 1:
        problem = f"expected one condition, got {' and '.join(given) or 'none'}"
        raise SignalCheckError(given[1] if given else "topic", problem, "above, below, equals, or changes: true")
    signal, some, _ = find_signal(when.topic, when.vehicles, vehicles)
    if when.changes is not None:
        return AskedMoment(signal, some, None)
    values = {key: getattr(when, key) for key in ("topic", "vehicles", "above", "below", "equals")}
    return AskedMoment(signal, some, ask(SignalCheck(**values), vehicles).condition)


def trigger_name(trigger: TriggerSection, number: int) -> str:
    """The id of the fault of a trigger, which is the `number`-th one."""
    return trigger.id or f"t{number}"


def wait_ns(trigger: TriggerSection, spec: ScenarioSpec) -> int:
    """How long after the moment the fault begins: a round, unless the trigger says more."""
    return spec.network.period if trigger.wait is None else trigger.wait


def fault_of(
    trigger: TriggerSection, name: str, at: int, i: int, spec: ScenarioSpec, near: Collection[int]
) -> FaultSection | None:
    """The fault that begins because of what a vehicle reported.

    Args:
        trigger: Whose moment has come.
        name: Of the fault.
        at: When it begins [ns].
        i: The vehicle that reported it.
        spec: Of the scenario.
        near: The vehicles that it hears.

    Returns:
        The fault; None if it is to act on neighbours or others, and the vehicle has none.

    Raises:
        pydantic.ValidationError: It is no fault.
    """
    others = [j for j in range(1, spec.vehicles + 1) if j != i]
    numbers = {"itself": str(i), "others": ",".join(map(str, others)), "neighbours": ",".join(map(str, sorted(near)))}
    if any(not numbers[word] for word in _relative(trigger.fault)):
        return None
    times = {"at": f"{at} ns"} | ({} if trigger.for_ is None else {"for": f"{trigger.for_} ns"})
    return read_entry({"id": name, **times, **_resolve(trigger.fault, numbers)})


def _relative(value: Any) -> set[str]:
    """The words in a fault that stand for vehicles."""
    if isinstance(value, dict):
        return set().union(*(_relative(part) for item in value.items() for part in item))
    return set(_RELATIVE.findall(value)) if isinstance(value, str) else set()


def _resolve(value: Any, numbers: Mapping[str, str]) -> Any:
    if isinstance(value, str):
        return _RELATIVE.sub(lambda match: numbers[match[1]], value)
    if isinstance(value, dict):
        return {_resolve(key, numbers): _resolve(one, numbers) for key, one in value.items()}
    return value


def moments(triggers: Sequence[TriggerSection], spec: ScenarioSpec) -> dict[str, str]:
    """When each trigger begins its fault, in words, by the id of the fault."""
    found = {}
    for number, trigger in enumerate(triggers, start=1):
        when = trigger.when
        given = [f"{key} {one}" for key in ("above", "below", "equals") if (one := getattr(when, key)) is not None]
        nth = "" if trigger.nth == 1 else f" (moment {trigger.nth})"
        after = f" from {show_time(when.after)} on" if when.after else ""
        moment = f"{when.topic} {(given or ['changes'])[0]}{nth}{after}"
        found[trigger_name(trigger, number)] = f"{show_time(wait_ns(trigger, spec))} after {moment}"
    return found


def trigger_lines(triggers: Sequence[TriggerSection], spec: ScenarioSpec) -> list[str]:
    """The triggers in words, a line each."""
    lines = []
    for trigger, (name, moment) in zip(triggers, moments(triggers, spec).items(), strict=True):
        lasts = "" if trigger.for_ is None else f" for {show_time(trigger.for_)}"
        (kind, what), *_ = trigger.fault.items()
        shown = f"{{{', '.join(f'{key}: {one}' for key, one in what.items())}}}" if isinstance(what, dict) else what
        lines.append(f"fault {moment}: {kind} {shown}{lasts} (id {name})")
    return lines
