"""The meaning of a check on a signal, in SI units: a condition, the values that it applies to, and its times.

| kind | word | what must hold |
|---|---|---|
| safety | (none) | the condition, in every sample |
| safety | `never` | it must not hold; with `for_at_least`: not for so long without a break |
| reaching | `sometimes` | it must hold in some sample of some run; with `for_at_least`: for so long without a break |
| liveness | `eventually_within` | it must begin to hold so soon, with `for_at_least`: and go on for so long |
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import Any, Literal

from fleet.errors import FleetError
from fleet.quantities import (
    DIMENSIONS,
    NUMBER,
    Dimension,
    QuantityError,
    describe_value,
    show_time,
    unknown_vehicle,
    vehicle_numbers,
)
from fleet.quantities import scalar as quantity
from fleet.scenario.schema.checks import CONDITIONS, EVERY, ChecksSection, SignalCheck
from fleet.scenario.sections.signals import (
    OF_THE_LAWS,
    OF_THE_PLANT,
    SignalError,
    SignalName,
    SignalPlace,
    VehicleSignals,
    parse_name,
    unit_of,
)

Over = Literal["each", "spread", "true"]  # what is compared: each vehicle's value, their spread, how many are true


class SignalCheckError(FleetError):
    """A check on a signal that makes no sense; `key` of it is wrong."""

    def __init__(self, key: str, problem: str, hint: str = "") -> None:
        super().__init__(f"{key}: {problem}" + (f"; {hint}" if hint else ""))
        self.key = key
        self.problem = problem
        self.hint = hint


@dataclass(frozen=True, slots=True)
class SignalCondition:
    """The values that meet a condition: those from `low` to `high`; `strict` excludes these two."""

    over: Over
    low: float
    high: float
    strict: bool
    words: str
    limit: float | None = None  # what values are compared with, if that is one value

    def holds(self, value: float) -> bool:
        """Whether it holds for a value."""
        return self.low < value < self.high if self.strict else self.low <= value <= self.high


@dataclass(frozen=True, slots=True)
class AskedOfSignal:
    """A check on a signal, in SI units; times in ns."""

    signal: SignalName
    unit: str  # "1": it has none
    vehicles: tuple[int, ...]
    condition: SignalCondition
    negated: bool  # True: samples that meet the condition count; False: samples that do not
    within_ns: int | None  # a liveness property must begin to hold within this time; None: it is a safety property
    least_ns: (
        int  # a safety property breaks if such samples last so long; 0: by one. A liveness property must hold so long
    )
    fault: str | None  # a liveness property counts from the end of this fault; None: from `after_ns`
    after_ns: int  # earlier samples do not count
    words: str
    sometimes: bool = False  # some run of a study must reach such samples; no single run fails for it


def ask(check: SignalCheck, vehicles: Mapping[int, Mapping[str, SignalPlace]]) -> AskedOfSignal:
    """The meaning of a check in SI units.

    `vehicles`: the signals of every vehicle of the scenario. Raises SignalCheckError: it makes no sense.
    """
    signal, some, unit = find_signal(check.topic, check.vehicles, vehicles)
    condition = _condition(check, unit)
    if condition.over != "each" and len(some) < 2:
        raise SignalCheckError(_given_keys(check)[0], "compares vehicles, but there is only one", "name two or more")
    _check_times(check)
    # Values agree within 5 s if no stretch without that is longer.
    least = check.for_at_least or 0 if check.agree_within is None else check.agree_within + 1
    words = f"{signal} {_when(check, condition)}"
    within = check.eventually_within
    return AskedOfSignal(
        signal, unit, some, condition, bool(check.never or check.sometimes), within, least, check.fault, check.after,
        words, bool(check.sometimes),
    )  # fmt: skip


def find_signal(
    topic: str, of: str | None, vehicles: Mapping[int, Mapping[str, SignalPlace]]
) -> tuple[SignalName, tuple[int, ...], str]:
    """The signal that a topic names, the vehicles that are meant, and its unit.

    `of`: the vehicles, as the scenario names them; None: all. Raises SignalCheckError: there is no such signal.
    """
    signal = parse_name(topic)
    if signal is None:
        problem = f"{describe_value(topic)} names no signal"
        raise SignalCheckError("topic", problem, 'write one such as state.z or "|error.e|"')
    if signal.vehicle is not None:
        hint = f'write topic: {signal._replace(vehicle=None)} and vehicles: "{signal.vehicle}"'
        raise SignalCheckError("topic", f"{signal} names a vehicle, which has a key of its own", hint)
    some = tuple(vehicles) if of is None else tuple(dict.fromkeys(vehicle_numbers(of)))
    if strangers := [i for i in some if i not in vehicles]:
        raise SignalCheckError("vehicles", unknown_vehicle(strangers[0], len(vehicles)).message)
    try:
        unit = unit_of(signal, (vehicles[i] for i in some))
    except SignalError as error:
        raise SignalCheckError("topic", error.problem, error.hint) from None
    if of is not None and (without := [i for i in some if signal.name not in vehicles[i]]):
        hint = "without the key all that have the signal count"
        raise SignalCheckError("vehicles", f"vehicle {without[0]} has no signal {signal.name}", hint)
    return signal, some, unit


def is_of_plugin(text: str) -> bool:
    """Whether a text names a signal that only a vehicle's laws or its plant may have."""
    signal = parse_name(text)
    if signal is None:
        return False
    of_roll = VehicleSignals(plant=()).places().keys() - VehicleSignals().places().keys()
    return signal.group in (*OF_THE_LAWS, OF_THE_PLANT) or signal.name in of_roll


def _given_keys(check: SignalCheck) -> list[str]:
    return [key for key in CONDITIONS if getattr(check, key) is not None]


_NOT_SOMETIMES = ("never", "eventually_within", "agree_within")


def _check_times(check: SignalCheck) -> None:
    timed = [key for key in ("never", "eventually_within", "for_at_least") if getattr(check, key) is not None]
    if check.agree_within is not None and timed:
        hint = "agree_within itself says how long values may differ"
        raise SignalCheckError(timed[0], 'cannot be combined with "agree_within"', hint)
    if check.sometimes and (beside := next((key for key in _NOT_SOMETIMES if getattr(check, key) is not None), None)):
        raise SignalCheckError("sometimes", f'cannot be combined with "{beside}"', "write two checks")
    if check.never and check.eventually_within is not None:
        raise SignalCheckError("never", 'cannot be combined with "eventually_within"', "write two checks")
    if timed == ["for_at_least"] and not check.sometimes:
        hint = "add one of them: otherwise the condition must always hold"
        raise SignalCheckError("for_at_least", 'needs "never", "sometimes" or "eventually_within"', hint)
    if check.fault is not None and check.eventually_within is None:
        hint = "add eventually_within: the longest time from the end of the fault"
        raise SignalCheckError("fault", 'needs "eventually_within"', hint)


def _condition(check: SignalCheck, unit: str) -> SignalCondition:
    given = _given_keys(check)
    if not given:
        raise SignalCheckError("topic", "the check has no condition", f"add one of {', '.join(CONDITIONS)}")
    if len(given) > 1 and given != ["equals", "within"]:
        raise SignalCheckError(given[1], f'cannot be combined with "{given[0]}"', "write two checks")
    key = given[0]
    if key == "within":
        return _range(check.within, unit)
    if key == "at_most_one":
        return SignalCondition("true", -inf, 1.0, False, "true in at most one vehicle", 1.0)
    if key == "agree_within":
        return SignalCondition("spread", 0.0, 0.0, False, "the same in all vehicles")
    value, shown = _number(key, getattr(check, key), unit), _show(getattr(check, key))
    if key == "equals":
        return _equals(check, value, shown, unit)
    if key == "above":
        return SignalCondition("each", value, inf, True, f"above {shown}", value)
    over: Over = "spread" if key == "spread_below" else "each"
    words = f"spread over the vehicles below {shown}" if over == "spread" else f"below {shown}"
    return SignalCondition(over, -inf, value, True, words, value)


def _equals(check: SignalCheck, value: float, shown: str, unit: str) -> SignalCondition:
    if isinstance(check.within, list):
        hint = "with equals it is a tolerance, such as within: 0.1"
        raise SignalCheckError("within", 'with "equals" expected one value, got a list', hint)
    off = 0.0 if check.within is None else _number("within", check.within, unit)
    words = f"equals {shown}" + (f" within {_show(check.within)}" if off else "")
    return SignalCondition("each", value - off, value + off, False, words)


def _range(given: Any, unit: str) -> SignalCondition:
    if not isinstance(given, list):
        problem = f"expected a range such as [0, 30], got {describe_value(given)}"
        raise SignalCheckError("within", problem, 'one value is a tolerance, which needs "equals"')
    low, high = (_number("within", one, unit) for one in given)
    if low > high:
        problem = f"the low end, {_show(given[0])}, is above the high end, {_show(given[1])}"
        raise SignalCheckError("within", problem, "write the lower value first")
    words = f"between {_show(given[0])} and {_show(given[1])}"
    return SignalCondition("each", low, high, False, words)


def _number(key: str, given: Any, unit: str) -> float:
    if isinstance(given, bool) and unit == "1":
        return float(given)
    try:
        return quantity(given, dimension_of(unit))
    except QuantityError as error:
        raise SignalCheckError(key, error.message, error.hint) from None


def dimension_of(unit: str) -> Dimension:
    """The dimension that a signal's unit is the SI unit of; of a unit that is not known here it is the only one."""
    if unit == "1":
        return NUMBER
    for dimension in DIMENSIONS:
        if dimension.units.get(unit) == 1:
            return dimension
    return Dimension(f"a value in {unit}", f"1 {unit}", {unit: Fraction(1)})


def _show(given: Any) -> str:
    """A value as the scenario writes it."""
    return " ".join(given.split()) if isinstance(given, str) else str(given).lower()


def _when(check: SignalCheck, condition: SignalCondition) -> str:
    words = [condition.words]
    if check.never or check.sometimes:
        words = ["never" if check.never else "sometimes", *words]
    if check.eventually_within is not None:
        begin = "the start" if check.after == 0 else show_time(check.after)
        if check.fault is not None:
            begin = "every fault" if check.fault == EVERY else f"fault {check.fault}"
        words.append(f"within {show_time(check.eventually_within)} after {begin}")
    if check.for_at_least is not None:
        words.append(f"for {show_time(check.for_at_least)} or longer")
    if check.agree_within is not None:
        words.append(f"within {show_time(check.agree_within)}")
    if check.after and (check.eventually_within is None or check.fault is not None):
        words.append(f"after {show_time(check.after)}")
    return " ".join(words) + (f", vehicles {check.vehicles}" if check.vehicles else "")


_HAVE_A_PICTURE = ("error.e_norm", "error.formation_norm")  # every report draws these two anyway


def checked_signals(checks: ChecksSection, looked_at: Iterable[str] = ()) -> list[SignalName]:
    """The signals that checks name or looked at, in their order, without the errors that are always drawn.

    `checks`: of the scenario. `looked_at`: signals that judged checks looked at. Only what laws and plants report
    counts there, since a check in Python may look at everything else.
    """
    texts = [check.topic for check in checks.signal or ()]
    texts += [text for text in looked_at if text.partition(".")[0] in (*OF_THE_LAWS, OF_THE_PLANT)]
    names = (parse_name(text) for text in dict.fromkeys(texts))
    return [name for name in names if name is not None and name.name not in _HAVE_A_PICTURE]
