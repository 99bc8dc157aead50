"""The checks that a run must pass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from fleet.quantities import describe_value
from fleet.scenario import value_types as v
from fleet.scenario.schema.programs import ProgramsCheck
from fleet.scenario.value_types import Section, mistake
from world.plugins.loading import CHECKS, entry_points_of


class Below(Section):
    """The largest value over all vehicles, or those named, stays below a limit from a time to the end."""

    below: v.PositiveLength
    after: v.Time = 0
    vehicles: v.VehicleNumbers | None = None


class AtMost(Section):
    """A count stays within a limit."""

    at_most: v.Count


WAIVED = "waived"


class Standing(AtMost):
    """A check that every scenario has, with at most 0, unless the file gives another limit or waives it."""

    at_most: v.Count = 0
    waived: bool = False  # `tumbled: waived` in the file


class Tumbled(Standing):
    """How often vehicles, all or those named, may tumble: pitch beyond `vehicle.tumble_pitch`."""

    vehicles: v.VehicleNumbers | None = None


def _standing(value: Any) -> Any:
    return {"waived": True} if value == WAIVED else value


def _show_standing(check: Standing | None) -> Any:
    return check and (WAIVED if check.waived else check.model_dump(exclude={"waived"}, exclude_none=True))


class MaxAge(Section):
    """The age of the last message that was delivered stays below a limit on some links, from a time to the end."""

    below: v.Period
    after: v.Time = 0
    links: v.LinkSelector = "*"


EVERY = "every"  # in place of a fault's id: each fault that ends before the run


class Recovery(Section):
    """After a fault has ended, an error comes below `within` in less than `below`, and stays there.

    It stays until the next fault begins, or to the end.
    """

    fault: str  # id of the fault: as given, or f1, f2, ...; or EVERY
    below: v.Period
    within: v.PositiveLength
    error: Literal["formation", "consensus"] = "formation"
    vehicles: v.VehicleNumbers | None = None


class MinSeparation(Section):
    """The distance of any two vehicles, of all or of the named ones, stays above a limit from a time to the end."""

    above: v.PositiveLength
    after: v.Time = 0
    vehicles: v.VehicleNumbers | None = None


class Connected(Section):
    """The messages delivered within every window of some length connect each vehicle with the reference."""

    window: v.Period
    after: v.Time = 0  # when the first window begins
    vehicles: v.VehicleNumbers | None = None  # the vehicles that must be connected; all


class PunctualCheck(Section):
    """Of what a network of nodes hands over, how much may leave later than it was due: the host is to blame for it."""

    late: v.Period = 20_000_000
    at_most: v.Probability = 0.01


def _quantity(value: Any) -> Any:
    if isinstance(value, (str, int, float)):  # a bool is an int
        return value
    raise mistake(f"expected a value with its unit, got {describe_value(value)}")


def _range(value: Any) -> Any:
    if isinstance(value, list):
        if len(value) != 2:
            raise mistake(f"expected a range of two values such as [0 m, 30 m], got {len(value)}")
        return [_quantity(one) for one in value]
    return _quantity(value)


def _true(value: Any) -> Any:
    if value is not True:
        raise mistake(f"expected true, got {describe_value(value)}", hint="or leave it out")
    return value


OnlyTrue = Annotated[Literal[True] | None, BeforeValidator(_true)]
Quantity = Annotated[Any, BeforeValidator(_quantity)]  # as written: what unit it needs, the signal says
_EVERYONE = BeforeValidator(lambda value: None if value == "all" else value)
CHECK_NAME = r"[A-Za-z][A-Za-z0-9_.-]{0,63}"


class SignalCheck(Section):
    """A condition on a signal of some vehicles, or between them, and when it has to hold."""

    name: str | None = None  # name of the verdict; default: the signal's
    topic: str  # topic group, dot, field: `state.z`, `|error.e|`
    vehicles: Annotated[v.VehicleNumbers | None, _EVERYONE] = None
    below: Quantity | None = None
    above: Quantity | None = None
    equals: Quantity | None = None
    within: Annotated[Any, BeforeValidator(_range)] = None  # a range; beside `equals` how far off it may be
    spread_below: Quantity | None = None  # the largest value of any vehicle minus the least
    at_most_one: OnlyTrue = None  # vehicle whose value is true: not 0
    agree_within: v.Period | None = None  # all values are equal, but for stretches shorter than this
    never: OnlyTrue = None  # the condition must not hold
    sometimes: OnlyTrue = None  # the condition must hold in some run of a study; no single run fails
    eventually_within: v.Period | None = None  # the condition must hold at some time, not always
    for_at_least: v.Period | None = None  # a time for which it holds without a break
    fault: str | None = None  # with `eventually_within`: counted from the end of this fault, or of EVERY
    after: v.Time = 0


CONDITIONS = ("below", "above", "equals", "within", "spread_below", "at_most_one", "agree_within")


def _instances(value: Any) -> Any:
    """The parameters of one check of a class, or of several."""
    each = value if isinstance(value, list) else [value]
    for one in each:
        if not isinstance(one, dict | None):
            raise mistake(f"expected the parameters of the check as a mapping, got {describe_value(one)}")
        if one and not isinstance(one.get("name", ""), str):
            raise mistake(f"expected its name as a text, got {describe_value(one['name'])}")
        if one:
            _true(one.get(SOMETIMES, True))
    return [one or {} for one in each]


SOMETIMES = "sometimes"  # a check in Python with this key must fail in some run
PYTHON = "<module>:<Class>"  # stands for the keys that name a class
Instances = Annotated[list[dict[str, Any]], BeforeValidator(_instances)]


def _as_list(value: Any) -> Any:
    """A single check may be given without the list."""
    if isinstance(value, dict):
        return [value]
    return None if value == [] else value


def _show_list(checks: Sequence[Section] | None, *, defaults: bool = True) -> Any:
    shown = [entry.model_dump(exclude_none=True, exclude_defaults=not defaults) for entry in checks or ()]
    return shown[0] if len(shown) == 1 else shown or None


_show_signals = partial(_show_list, defaults=False)


class OwnCheck(NamedTuple):
    """One of the user's own checks: where it is, and what its verdict is called."""

    key: str  # `signal`, or `package.module:Class`
    place: int  # place among the checks of this key
    name: str
    given: bool  # the name is the user's
    sometimes: bool = False  # whether it must be reached in some run of many


class ChecksSection(Section):
    """The checks that decide whether a run passes; `tumbled` and `deaths` are checked by default."""

    formation_error: Below | None = None  # |eta_i - eta_i^d|
    consensus_error: Below | None = None  # |e_i| from true positions
    recovery_time: Annotated[list[Recovery] | None, BeforeValidator(_as_list), PlainSerializer(_show_list)] = None
    min_separation: MinSeparation | None = None
    max_age: MaxAge | None = None
    connected: Connected | None = None
    tumbled: Annotated[Tumbled | None, BeforeValidator(_standing), PlainSerializer(_show_standing)] = None
    deaths: Annotated[Standing | None, BeforeValidator(_standing), PlainSerializer(_show_standing)] = None
    qp_infeasible: AtMost | None = None
    ledger: Literal["balanced"] | None = None
    middleware_loss: AtMost | None = None
    punctual: PunctualCheck | None = None  # nodes: on by default
    programs: ProgramsCheck | None = None  # that they run, or end well; of vehicles, that none fails; on by default
    signal: Annotated[list[SignalCheck] | None, BeforeValidator(_as_list), PlainSerializer(_show_signals)] = None
    python: Annotated[dict[str, Instances] | None, Field(alias=PYTHON)] = None

    @model_validator(mode="before")
    @classmethod
    def _read_python(cls, value: Any) -> Any:
        """Put the checks that are classes under one key."""
        if not isinstance(value, dict):
            return value
        known = cls.model_fields.keys() - {"python"}
        others = {key: one for key, one in value.items() if isinstance(key, str) and key not in known}
        classes = {key: one for key, one in others.items() if ":" in key or key in entry_points_of(CHECKS)}
        return {key: one for key, one in value.items() if key not in classes} | ({PYTHON: classes} if classes else {})

    @model_serializer(mode="wrap")
    def _show_python(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        shown: dict[str, Any] = write(self)
        classes = shown.pop(PYTHON, None) or shown.pop("python", None) or {}
        return shown | {name: each[0] if len(each) == 1 else each for name, each in classes.items()}

    @property
    def unstated(self) -> frozenset[str]:
        """The checks that are on by default and are not what this scenario asks about: it states others."""
        stated = self.model_fields_set - {"tumbled", "deaths"} and self.tumbled is None
        return frozenset({"tumbled"}) if stated else frozenset()

    def own(self) -> Iterator[OwnCheck]:
        """The user's own checks; each name comes once, unless two were given the same."""
        named: list[tuple[str, int, str | None, str, bool]] = []
        for k, check in enumerate(self.signal or ()):
            named.append(("signal", k, check.name, check.topic.strip("| "), bool(check.sometimes)))
        for key, each in (self.python or {}).items():
            name = key.rpartition(":")[2]
            named += [(key, k, one.get("name"), name, SOMETIMES in one) for k, one in enumerate(each)]
        taken = {*OF_THE_SCHEMA, *(each[2] for each in named if each[2] is not None)}
        for key, k, given, otherwise, sometimes in named:
            name, number = given or otherwise, 1
            while given is None and name in taken:
                number += 1
                name = f"{otherwise}-{number}"
            taken.add(name)
            yield OwnCheck(key, k, name, given is not None, sometimes)


OF_THE_SCHEMA = frozenset({*ChecksSection.model_fields, "expect", "on_time"})  # names that verdicts have already
