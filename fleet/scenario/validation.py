"""A tree of YAML is checked by the schema and the rules: every mistake is found, each where it was written.

The schema is of pydantic. msgspec was rejected, because it stops at the first mistake, and its path is a text
(`Invalid enum value 'tdna' - at $.acoustic.mac`). pydantic costs at most 0.2 s of a start, and only the console imports
it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, cast, get_args, get_origin

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from fleet.errors import Problem
from fleet.quantities import describe_value
from fleet.scenario.parts import Parts, UnknownValueError
from fleet.scenario.rules import (
    checks,
    faults,
    laws,
    link_conditions,
    motion,
    navigation,
    network,
    nodes,
    periods,
    programs,
)
from fleet.scenario.rules.report import Report, dotted_path
from fleet.scenario.schema.checks import PYTHON
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, locate, plain, text_place
from fleet.scenario.trust import READING, Policy
from fleet.scenario.value_types import Section, mistake_words, section_of
from netem.parsing import nearest

# What a hint offers for a key of the whole scenario that is missing.
EXAMPLES = {
    "title": "Four vehicles in a square",
    "vehicles": "4",
    "duration": "60 s",
    "reference": "{start: 0 0 5 m, velocity: 0.5 0 0 m/s}",
    "formation": "{shape: line, spacing: 8 m}",
    "graph": "{shape: ring}",
    "initial": "{scatter: 0.5 m, around: reference}",
    "network": "{period: 100 ms, links: {'*': delay 100ms loss 20%}}",
}

# By the kind of pydantic's error: what is expected, and a hint.
_WANTED = {
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float", "int_parsing_size"), ("expected a whole number", "")),
    "greater_than_equal": ("must be {ge} or more", ""),
    "less_than_equal": ("must be {le} or less", ""),
    "less_than": ("must be less than {lt}", ""),
    "list_type": ("expected a list", ""),
    "string_too_short": ("must not be empty", ""),
    "string_type": ("expected a text", "quotes make it a text"),
    "string_pattern_mismatch": ("expected lower-case letters, digits, - and _", "it names the run's directory"),
}

Loc = tuple[str | int, ...]


RULES: tuple[Callable[[Parts, Report], None], ...] = (
    periods.duration,
    periods.network_period,
    network.ideal,
    periods.qp_period,
    motion.reference,
    motion.formation,
    motion.initial,
    motion.graph_form,
    motion.edges,
    motion.followers,
    motion.knowledge,
    network.links,
    link_conditions.link_conditions,
    network.radios,
    network.acoustic,
    network.talking,
    nodes.nodes,
    nodes.contents,
    programs.programs,
    programs.signals,
    laws.per_vehicle,
    motion.moored,
    navigation.navigation,
    faults.faults,
    faults.nemesis,
    checks.checks,
    checks.max_age,
    checks.connected,
    checks.recovery_time,
    laws.laws,
    laws.plants,
    navigation.localization,
    navigation.faults,
    checks.signal,
    checks.triggers,
    checks.python,
    checks.names,
    laws.effective,
    laws.rolls,
    laws.keep_apart,
    laws.vehicles,
    laws.velocity_bounds,
    laws.gain_bounds,
    laws.cosine_guard,
)

# Rules that need what only vehicles of ours have: a scenario of nodes is not judged by them.
OF_VEHICLES = frozenset(rule for rule in RULES if rule.__module__ == laws.__name__) | {
    periods.qp_period,
    navigation.localization,
}


def validate(root: Mapping, folder: Path | None = None, policy: Policy = READING) -> tuple[Parts | None, list[Problem]]:
    """Every mistake in a scenario, and its parts; None instead of these if there is a mistake.

    Rules that compare keys are also applied if other keys are wrong. So one call finds as many mistakes as possible.
    """
    data = plain(root)
    report = Report(root, policy=policy)
    try:
        spec = ScenarioSpec.model_validate(data)
    except ValidationError as error:
        report.problems += _explained(root, error.errors(include_url=False), report.keys("nodes"))
        spec = cast(ScenarioSpec, _Partial(ScenarioSpec, data))
    parts = Parts(spec, folder)
    if isinstance(spec, ScenarioSpec) and "nodes" not in root.entries:
        for path in laws.superfluous(parts, report):
            root = _drop_key(root, path)
        if root is not report.root:
            return validate(root, folder, policy)
    apply_rules(parts, report)
    return (None if report.problems else parts), report.problems


def _drop_key(root: Mapping, path: Sequence[str]) -> Mapping:
    """The tree without a key."""
    key, *rest = path
    inner = root.entries[key]
    if not rest or not isinstance(inner, Mapping):
        return root.without(key)
    return Mapping(root.entries | {key: _drop_key(inner, rest)}, root.keys, root.place)


def apply_rules(parts: Parts, report: Report) -> None:
    """Report every mistake that a rule finds.

    A rule looks at a few keys. It stops when it reads a value that is wrong by itself (`UnknownValueError`), because
    that mistake is reported already; the other rules go on.
    """
    with_nodes = "nodes" in report.root.entries
    for rule in RULES:
        if with_nodes and rule in OF_VEHICLES:
            continue
        try:
            rule(parts, report)
        except UnknownValueError:
            continue


class _Partial:
    """The valid values of a section that as a whole is not; to read another raises UnknownValueError."""

    def __init__(self, section: type[Section], data: dict[str, Any]) -> None:
        self._section = section
        self._data = data

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        raise UnknownValueError

    def __getattr__(self, name: str) -> Any:
        info = self._section.model_fields.get(name)
        if info is None:  # something that only a whole section can do
            raise UnknownValueError
        key = info.alias or name
        if key not in self._data:
            if info.is_required():
                raise UnknownValueError
            return info.get_default(call_default_factory=True)
        value = self._data[key]
        kind = _kind(self._section, name)
        try:
            return kind.validate_python(value, strict=True)
        except ValidationError as error:
            return _valid_part(info.annotation, kind, value, [detail["loc"] for detail in error.errors()])


def _valid_part(annotation: Any, kind: TypeAdapter[Any], value: Any, wrong: list[Loc]) -> Any:
    """What is valid of a section, or of the entries of a mapping. Raises UnknownValueError: nothing.

    Args:
        annotation: of the value.
        kind: reads it.
        value: as it was written.
        wrong: the places of its mistakes, from it on.
    """
    section = None if _holds_many(annotation) else section_of(annotation)
    if not isinstance(value, dict) or (section is None and any(not loc or loc[0] not in value for loc in wrong)):
        raise UnknownValueError
    if section is not None:
        return _Partial(section, value)
    bad = {loc[0] for loc in wrong}
    try:
        good = kind.validate_python({key: entry for key, entry in value.items() if key not in bad}, strict=True)
    except ValidationError:  # what is left is too little, as one node of two
        raise UnknownValueError from None
    if (section := _section_of_entries(annotation)) is None:
        return good
    nameless, rest = {loc[0] for loc in wrong if loc[1:2] == ("[key]",)}, iter(good.items())
    # A wrong entry stays, for what names it is no mistake.
    named = {key: _Partial(section, entry if isinstance(entry, dict) else {}) for key, entry in value.items()}
    return dict((key, named[key]) if key in bad else next(rest) for key in value if key not in nameless)


def _section_of_entries(annotation: Any) -> type[Section] | None:
    """The section that each entry of a mapping is; None: there is none, or it may be written otherwise, too."""
    if get_origin(annotation) is dict:
        entry = get_args(annotation)[1]
        return entry if isinstance(entry, type) and issubclass(entry, Section) else None
    return next(filter(None, map(_section_of_entries, get_args(annotation))), None)


@cache
def _kind(section: type[Section], name: str) -> TypeAdapter[Any]:
    return TypeAdapter(section.model_fields[name].rebuild_annotation())


def _explained(root: Mapping, errors: Sequence[ErrorDetails], names: Sequence[str]) -> list[Problem]:
    """The problems in words; `names`: of nodes. A key that is missing because it is misspelt is told
    once: where it is.
    """
    errors = [error for error in errors if not _is_of_another_form(error, errors)]
    meant: dict[Loc, str] = {}  # by the place of an unknown key
    for error in errors:
        if error["type"] == "extra_forbidden":
            loc, section = error["loc"], error["loc"][:-1]
            missing, unknown = (_keys_of(errors, kind, section) for kind in ("missing", "extra_forbidden"))
            near = [key for key in missing if nearest(str(loc[-1]), [key])]
            if section and len(missing) == len(unknown) == 1:  # whatever it is called: `command` for `run`
                near = missing
            meant.update((loc, key) for key in near[:1])
    told = {(*loc[:-1], key) for loc, key in meant.items()}
    return [
        _explain(root, error, names, meant.get(error["loc"], ""))
        for error in errors
        if error["type"] != "missing" or error["loc"] not in told
    ]


def _is_form(step: str | int) -> bool:
    """Whether a step of a path in the model names one of several forms: the class of a section, or what reads texts."""
    return isinstance(step, str) and (step[:1].isupper() or step.startswith("function-"))


def _is_of_another_form(error: ErrorDetails, errors: Sequence[ErrorDetails]) -> bool:
    """Whether a value that may be a section or a text was read as the other one, and is told as what it is, too."""
    *before, form = error["loc"]
    if not _is_form(form) or (error["type"] == "model_type") is isinstance(error["input"], dict):
        return False
    return any(other is not error and other["loc"][: len(before)] == (*before,) for other in errors)


def _keys_of(errors: Sequence[ErrorDetails], kind: str, section: Loc) -> list[str]:
    return [str(error["loc"][-1]) for error in errors if error["type"] == kind and error["loc"][:-1] == section]


def _explain(root: Mapping, error: ErrorDetails, names: Sequence[str], meant: str) -> Problem:
    """A problem in words; `meant`: the key that an unknown one stands for, if that is known."""
    loc = error["loc"]
    path = _file_path(root, loc)
    context, value = error.get("ctx", {}), error["input"]
    name = dotted_path(path)
    match error["type"]:
        case "missing":
            section = dotted_path(path[:-1])
            where = f' in "{section}"' if section else ""
            hint = f"for example {name}: {EXAMPLES[name]}" if name in EXAMPLES else ""
            return locate(root, path[:-1], key=True).problem(f'"{path[-1]}" is missing{where}', hint, name)
        case "extra_forbidden":
            place = locate(root, path, key=True)
            hint = f'did you mean "{meant}"?' if meant else _nearest_key(loc)
            return place.problem(f'unknown key "{_short(name)}"', hint, name)
        case "mistake":
            if path[-1] == "[key]":
                path = path[:-1]
                place, name = locate(root, path, key=True).shift(context["column"]), dotted_path(path[:-1])
            else:
                place = text_place(root, path, context["column"])
            return place.problem(f"{_short(name)}: {mistake_words(context, names)}", context["hint"], name)
        case "literal_error":
            words = re.findall(r"'([^']*)'", context["expected"])
            hint = nearest(value, words) if isinstance(value, str) else ""
            message = f"expected {' or '.join(words)}, got {describe_value(value)}"
        case "model_type" | "dict_type" | "model_attributes_type":
            message = f"expected keys with values, got {describe_value(value)}"
            hint = nearest(str(loc[-1]), [key for key in _siblings(loc) if key != loc[-1]]) or "write {key: value}"
        case "too_short":
            message, hint = f"must have {context['min_length']} or more entries, got {context['actual_length']}", ""
        case kind:
            wanted, hint = _WANTED.get(kind, ("{msg}", ""))
            message = f"{wanted.format_map({**context, 'msg': error['msg']})}, got {describe_value(value)}"
    return locate(root, path).problem(f"{_short(name)}: {message}", hint, name)


def _file_path(root: Mapping, loc: Loc) -> Loc:
    """The path in the file of a path in the model.

    The model has a step more for the form of `initial` and of what may be a section or a text, for checks in Python,
    and for an entry that the file writes without its list.
    """
    if loc[0] == "initial" and len(loc) > 1:
        return loc[:1] + loc[2:]
    path: Loc = ()
    node: Node | None = root
    for step in loc:
        if step == PYTHON or (isinstance(node, Mapping) and isinstance(step, int)):
            continue
        if _is_form(step) and not (isinstance(node, Mapping) and step in node.entries):
            continue
        path += (step,)
        if isinstance(node, Mapping):
            node = node.entries.get(str(step))
        elif isinstance(node, Items) and isinstance(step, int) and step < len(node.items):
            node = node.items[step]
        else:
            node = None
    return path


def _siblings(loc: Loc) -> list[str]:
    """The keys of the section that a path ends in."""
    section: type[Section] = ScenarioSpec
    for step in loc[:-1]:
        if isinstance(step, str) and step in section.model_fields:
            section = section_of(section.model_fields[step].annotation) or section
    return [info.alias or name for name, info in section.model_fields.items()]


def _nearest_key(loc: Loc) -> str:
    key, siblings = str(loc[-1]), _siblings(loc)
    if hint := nearest(key, siblings, 0.8):
        return hint
    hint = nearest(key, siblings)
    elsewhere = [path for path in _everywhere() if path.rpartition(".")[2] == key]
    if elsewhere:
        other = f'"{min(elsewhere, key=lambda path: path.count("."))}"?'
        return hint.replace("?", f" or {other}") if hint else f"did you mean {other}"
    return hint or f"known here: {', '.join(siblings)}"


@cache
def _everywhere() -> list[str]:
    return list(_paths(ScenarioSpec, ""))


def _paths(section: type[Section], prefix: str) -> Iterator[str]:
    for name, info in section.model_fields.items():
        name = info.alias or name
        yield prefix + name
        below = section_of(info.annotation)
        if below is not None:
            yield from _paths(below, f"{prefix}{name}.")


def _holds_many(annotation: Any) -> bool:
    return get_origin(annotation) in (list, dict) or any(_holds_many(argument) for argument in get_args(annotation))


def _short(name: str) -> str:
    return name if len(name) <= 60 else name[:57] + "..."
