"""Reads the value of a field of a study from a file, a script or the command line, as the spec keeps it.

Every mistake is a StudyError in words. It does not name the field, because each of the three has its own name for it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from inspect import Parameter, signature
from math import inf, isfinite
from typing import Any, Literal, TypedDict, TypeVar

from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.plan import parse_seeds
from fleet.addons.studies.signal_measures import check_name
from fleet.addons.studies.spec import KeepLogs, Spec
from fleet.addons.studies.stopping import check_until
from fleet.addons.studies.values import axis, key_and_values, parse_axis, values_text
from fleet.errors import printable
from fleet.execution.stepped_run import override_texts
from fleet.option import Kind, OptionField, fields
from fleet.quantities import QuantityError, describe_value, show_time, time_ns
from fleet.scenario.text.yaml_writer import inline
from netem.parsing import nearest

F = TypeVar("F", bound=Callable[..., Any])
_QUOTED = re.compile(r"'([^']*)'")


def read(field: OptionField, value: object, key: str = "") -> Any:
    """Check and convert one value of a field: the whole value, one entry of its list, or the value of one key. `value`:
    a plain value of a file or a script, or a text of the command line. `key`: the key of the value, if the field has
    texts by key. Raises StudyError: the value does not fit the field."""
    if field.shape is bool:
        return _checked(value, isinstance(value, bool), "true or false")
    if field.shape is int:
        least, most = field.limits
        fits = type(value) is int and (least is None or value >= least) and (most is None or value <= most)
        return _checked(value, fits, f"a whole number from {least} {'on' if most is None else f'to {most}'}")
    if field.shape is float:
        return _checked(value, isinstance(value, int | float) and not isinstance(value, bool), "a number")
    if field.shape is Literal:
        return _checked(value, value in field.words, f"one of {', '.join(field.words)}")
    text = _text(field.kind, value)
    if printable(text) != text:  # it is shown on terminals
        raise StudyError("a line break or a control character is in it")
    _check(field.kind, key, text)
    return text


def _checked(value: object, fits: bool, expected: str) -> Any:
    if not fits:
        raise StudyError(f"expected {expected}, got {describe_value(value)}")
    return value


def _text(kind: Kind, value: object) -> str:
    if kind is Kind.SEEDS:
        return seeds_text(value)
    if kind is Kind.VALUES:
        return values_text(value)
    if kind is Kind.VALUE and not isinstance(value, str):
        return inline(value)
    return str(_checked(value, isinstance(value, str), "a text"))


def _check(kind: Kind, key: str, text: str) -> None:
    """Raises StudyError: a text is none of its kind. An empty one stands for nothing."""
    if kind is Kind.SEEDS:
        parse_seeds(text)
    elif kind is Kind.VALUES:
        axis(key, text)
    elif kind is Kind.ALONG:
        parse_axis(text, fine=1)
    elif kind is Kind.MEASURE and text:
        check_name(text)
    elif kind is Kind.UNTIL and text:
        check_until(text)
    elif kind is Kind.TIME and text:
        try:
            _checked(text, time_ns(text) >= 0, "a time that is not negative")
        except QuantityError as error:
            raise StudyError(f"{error.message}{f'; {error.hint}' if error.hint else ''}") from None


class BoundaryKeywords(TypedDict, total=False):
    """The keywords of `fleet.boundary` that a spec declares; a test compares them with `BoundarySpec`."""

    check: str | None
    level: float | None
    width: float | None
    seeds: int | str | Iterable[int] | None
    set: Mapping[str, object] | Iterable[str] | None
    net: str | Iterable[str] | None
    fault: str | Iterable[str] | None
    timeout_s: float | None


class SweepKeywords(TypedDict, total=False):
    """The same of `fleet.sweep` and `StudySpec`."""

    zipped: bool | None
    seeds: int | str | Iterable[int] | None
    draw: int | None
    set: Mapping[str, object] | Iterable[str] | None
    net: str | Iterable[str] | None
    fault: str | Iterable[str] | None
    check: str | None
    measures: str | Iterable[str] | None
    until: str | None
    most_seeds: int | None
    keep_logs: KeepLogs | None
    timeout_s: float | None
    budget_s: float | None


def keywords(spec: Spec, options: Mapping[str, object]) -> dict[str, Any]:
    """The values of a spec that a script gives by keyword; None: not given. Raises TypeError: there is no such keyword;
    StudyError: a value is wrong."""
    known, given = _fields_by_keyword(spec), {}
    for keyword, value in options.items():
        if keyword not in known:
            hint = nearest(keyword, known) or f"known here: {', '.join(known)}"
            raise TypeError(f"there is no argument {keyword!r}; {hint}")
        field = known[keyword]
        if value is None or (field.kind is Kind.TIME and value == inf):
            continue
        try:
            given[field.name] = _script_value(field, value)
        except StudyError as error:
            raise StudyError(f"{keyword}: {error}") from None
    return given


def _script_value(field: OptionField, value: Any) -> Any:
    if field.kind is Kind.VALUE:
        value = set_values(override_texts(value))
    if field.kind is Kind.TIME:
        fits = isinstance(value, int | float) and isfinite(value) and value >= 0
        value = show_time(round(_checked(value, fits, "a number of seconds") * 1e9))
    if field.shape is dict:
        return {key: read(field, inner, key) for key, inner in value.items()}
    if field.shape is list:
        return [read(field, item) for item in ([value] if isinstance(value, str) else value)]
    return read(field, value)


def _fields_by_keyword(spec: Spec) -> dict[str, OptionField]:
    return {field.keyword: field for field in fields(spec).values() if field.flag is not None}


def takes(spec: Spec) -> Callable[[F], F]:
    """Describe what a function hands to `keywords`: its `**options` in the signature and in the docstring."""

    def describe(function: F) -> F:
        own = signature(function).parameters
        fields = {keyword: field for keyword, field in _fields_by_keyword(spec).items() if keyword not in own}
        named = [each for each in own.values() if each.kind is not Parameter.VAR_KEYWORD]
        named += [Parameter(keyword, Parameter.KEYWORD_ONLY, default=None) for keyword in fields]
        function.__signature__ = signature(function).replace(parameters=named)  # type: ignore[attr-defined]

        def described(place: re.Match[str]) -> str:  # its indentation depends on the version of Python
            return "\n".join(f"{place[1]}{keyword}: {_describe(field)}" for keyword, field in fields.items())

        function.__doc__ = re.sub(r"( *)options: these\.", described, function.__doc__ or "")
        return function

    return describe


def _describe(field: OptionField) -> str:
    unit = " [s]" if field.kind is Kind.TIME else ""
    default = f" By default {field.default}." if field.default not in ("", [], {}, False) else ""
    return _QUOTED.sub(r"`\1`", field.option.help.removesuffix(".")) + f"{unit}.{default}"


def texts_by_key(field: OptionField, texts: Iterable[str]) -> dict[str, str]:
    """The texts of an option that is given once per key. Raises StudyError: one has no key, or a key is twice there."""
    return set_values(texts) if field.kind is Kind.VALUE else varied_values(texts, str(field.flag))


def set_values(texts: Iterable[str]) -> dict[str, str]:
    """The values of several `--set KEY=VALUE` by key, of a key the last. Raises StudyError: one has no key."""
    values: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise StudyError(f"--set {text[:80]}: expected KEY=VALUE such as 'duration=20 s'")
        values.pop(key, None)
        values[key] = value
    return values


def varied_values(texts: Iterable[str], flag: str = "--vary") -> dict[str, str]:
    """The VALUES of several `--vary KEY=VALUES`, or of another flag, by key. Raises StudyError: one has no key, or a
    key is there twice."""
    found: dict[str, str] = {}
    for text in texts:
        try:
            key, values = key_and_values(text)
        except StudyError as error:
            raise StudyError(f"{flag}: {error}") from None
        if key in found:
            raise StudyError(f"{key} is varied twice: give all its values at once")
        found[key] = values
    return found


def seeds_text(seeds: object) -> str:
    """The text of how many seeds there are, or which."""
    if isinstance(seeds, str) or not isinstance(seeds, Iterable):
        return str(seeds)
    numbers = [*seeds]
    return ",".join(map(str, [*numbers, *numbers[:1]]))  # one alone would be how many
