"""Read a scenario, shipped or from a file, apply overrides, and report every mistake at once."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast, get_args, get_origin

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from fleet.errors import Problem, ScenarioError
from fleet.quantities import describe_value
from fleet.scenario.catalogue import shipped_scenarios, shipped_text
from fleet.scenario.parts import Parts, UnknownValueError
from fleet.scenario.rules.apply import check
from fleet.scenario.rules.report import Report, dotted
from fleet.scenario.scenario import Reading, Scenario
from fleet.scenario.schema.checks import PYTHON
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.text.nodes import expanded, still
from fleet.scenario.text.overrides import Override, apply
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Scalar, Source, locate, plain, read, text_place
from fleet.scenario.trust import READING, TYPED, OverrideOrigin, Policy, ran_from, stranger
from fleet.scenario.value_types import Section, section_of
from netem.files import read_bounded, read_file
from netem.limits import SCENARIO
from netem.parsing import nearest

# --- validation
# A tree of YAML against the schema and the rules: every mistake, each where it was written.


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
    "string_type": ("expected a text", "quotes make it a text"),
    "string_pattern_mismatch": ("expected lower-case letters, digits, - and _", "it names the run's directory"),
}

Loc = tuple[str | int, ...]


def validate(root: Mapping, folder: Path | None = None, policy: Policy = READING) -> tuple[Parts | None, list[Problem]]:
    """Every mistake in a scenario, and its parts; None instead of these if there is a mistake.

    Rules that compare keys are also applied if other keys are wrong. So one call finds as many mistakes as possible.
    """
    data = plain(root)
    report = Report(root, policy=policy)
    try:
        spec = ScenarioSpec.model_validate(data)
    except ValidationError as error:
        report.problems += [_explain(root, detail) for detail in error.errors(include_url=False)]
        spec = cast(ScenarioSpec, _Partial(ScenarioSpec, data))
    parts = Parts(spec, folder)
    check(parts, report)
    return (None if report.problems else parts), report.problems


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
            section = None if _holds_many(info.annotation) else section_of(info.annotation)
            locs = [detail["loc"] for detail in error.errors()]
            entries = {(key,) for key in value} if isinstance(value, dict) else set()
            if not isinstance(value, dict) or (section is None and any(loc[:1] not in entries for loc in locs)):
                raise UnknownValueError from None
            if section is not None:
                return _Partial(section, value)
            bad = {loc[0] for loc in locs}
            try:
                return kind.validate_python({k: v for k, v in value.items() if k not in bad}, strict=True)
            except ValidationError:  # what is left is too little, as one node of two
                raise UnknownValueError from None


@cache
def _kind(section: type[Section], name: str) -> TypeAdapter[Any]:
    return TypeAdapter(section.model_fields[name].rebuild_annotation())


def _explain(root: Mapping, error: ErrorDetails) -> Problem:
    loc = error["loc"]
    path = _in_file(root, loc)
    context, value = error.get("ctx", {}), error["input"]
    name = dotted(path)
    match error["type"]:
        case "missing":
            section = dotted(path[:-1])
            where = f' in "{section}"' if section else ""
            hint = f"for example {name}: {EXAMPLES[name]}" if name in EXAMPLES else ""
            return locate(root, path[:-1], key=True).problem(f'"{path[-1]}" is missing{where}', hint, name)
        case "extra_forbidden":
            place = locate(root, path, key=True)
            return place.problem(f'unknown key "{_short(name)}"', _nearest_key(loc), name)
        case "mistake":
            if path[-1] == "[key]":
                path = path[:-1]
                place, name = locate(root, path, key=True).shifted(context["column"]), dotted(path[:-1])
            else:
                place = text_place(root, path, context["column"])
            return place.problem(f"{_short(name)}: {context['message']}", context["hint"], name)
        case "literal_error":
            words = re.findall(r"'([^']*)'", context["expected"])
            hint = nearest(value, words) if isinstance(value, str) else ""
            message = f"expected {' or '.join(words)}, got {describe_value(value)}"
        case "model_type" | "dict_type" | "model_attributes_type":
            message = f"expected keys with values, got {describe_value(value)}"
            hint = nearest(str(loc[-1]), [key for key in _siblings(loc) if key != loc[-1]]) or "write {key: value}"
        case kind:
            wanted, hint = _WANTED.get(kind, ("{msg}", ""))
            message = f"{wanted.format_map({**context, 'msg': error['msg']})}, got {describe_value(value)}"
    return locate(root, path).problem(f"{_short(name)}: {message}", hint, name)


def _in_file(root: Mapping, loc: Loc) -> Loc:
    """The path in the file of a path in the model.

    The model has a step more for the form of `initial`, for checks in Python, and for an entry that the file writes
    without its list.
    """
    if loc[0] == "initial" and len(loc) > 1:
        return loc[:1] + loc[2:]
    path: Loc = ()
    node: Node | None = root
    for step in loc:
        if step == PYTHON or (isinstance(node, Mapping) and isinstance(step, int)):
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


def load_scenario(
    name_or_path: str | Path,
    overrides: Sequence[str | Override] = (),
    *,
    imports: bool = True,
    refused: list[Problem] | None = None,
    origin: OverrideOrigin = TYPED,
) -> Scenario:
    """The scenario of a shipped name or of a file, with overrides applied.

    Args:
        overrides: changes by options; a text alone is `key.path=value`, as for `--set`.
        imports: import the laws that the file names, to check that they can be used.
        refused: a list that receives the laws that may not run. None: such a law is an error.
        origin: the source of the overrides.

    Raises ScenarioError: with every mistake that was found, in the order of the file.
    """
    shown, text, folder = _text(str(name_or_path))
    why = origin.stranger or ("" if folder is None else stranger(Path(shown)))
    policy = Policy(why, imports, refused, origin.typed, own=ran_from(text) if why else ())
    return parse_scenario(text, shown, overrides, folder, policy)


def parse_scenario(
    text: str,
    source_name: str,
    overrides: Sequence[str | Override] = (),
    folder: Path | None = None,
    policy: Policy = READING,
) -> Scenario:
    """The scenario that `text` describes. A text without a name is named after its source.

    Args:
        overrides: changes by options; a text alone is `key.path=value`, as for `--set`.
        folder: the search for files of vehicles, and for modules of laws that are not installed, begins here. The
            current directory follows.
        policy: these modules may run; by default none.

    Raises ScenarioError: with every mistake that was found, in the order of the text.
    """
    source = Source(source_name, text)
    root, problems = read(source)
    if not isinstance(root, Mapping):
        if root is not None:
            got = describe_value(plain(root))
            problems.append(root.place.problem(f"expected keys with values, such as duration: 30 s; got {got}"))
        raise ScenarioError(problems)
    if "name" not in root.entries:
        name = re.sub(r"[^a-z0-9_-]+", "-", Path(source_name).stem.lower()).strip("-_")[:64] or "scenario"
        root = root.with_entry("name", root.place, Scalar(name, root.place))
    root, more = apply(root, overrides)
    root = expanded(root, problems) if "nodes" in root.entries else still(root)
    parts, mistakes = validate(root, folder, policy)
    problems += [*more, *mistakes]
    if parts is None or problems:
        raise ScenarioError(sorted(problems, key=lambda p: _order(p, source, overrides)))
    return Scenario(parts, Reading(text, tuple(overrides), folder, policy), source_name)


def changed(scenario: Scenario, overrides: Sequence[str | Override]) -> Scenario:
    """Read the text of a scenario once more, with further overrides after the earlier ones.

    All values that the seed draws are drawn anew. Problems name the lines of the file. Raises ScenarioError.
    """
    text, before, folder, policy = scenario.reading
    return parse_scenario(text, scenario.source, [*before, *overrides], folder, replace(policy, refused=None))


def _order(problem: Problem, source: Source, overrides: Sequence[str | Override]) -> tuple[int, int, int]:
    rank = 0 if problem.file == source.name else 1 + [Override.of(o).name for o in overrides].index(problem.file)
    return rank, problem.line, problem.column


def _text(name_or_path: str) -> tuple[str, str, Path | None]:
    """Name of the source for problems, its text and its folder. An unknown name with a suffix or a slash is a path."""
    try:
        if name_or_path in shipped_scenarios():
            return f"{name_or_path}.yaml", shipped_text(name_or_path), None
        path = Path(name_or_path)
        if path.suffix == ".py":
            raise _unreadable(name_or_path, *_python_file(path))
        if path.suffix or "/" in name_or_path or path.exists():
            return name_or_path, _content(path).decode("utf-8-sig"), path.parent
    except UnicodeDecodeError as error:
        hint = "a log? fleet run --from goes on from one, fleet export --scenario makes a scenario of one"
        raise _unreadable(name_or_path, f"not UTF-8 text (byte {error.start})", hint) from None
    except IsADirectoryError:
        inside = path / "scenario.yaml"
        hint = f"did you mean {inside}, the scenario of that run?" if inside.exists() else ""
        raise _unreadable(name_or_path, "is a directory, not a scenario file", hint) from None
    except FileNotFoundError as error:
        raise _unreadable(name_or_path, error.strerror or str(error), _instead(path)) from None
    except (OSError, ValueError) as error:
        raise _unreadable(name_or_path, getattr(error, "strerror", None) or str(error)) from None
    hint = nearest(name_or_path, shipped_scenarios()) or "a file needs its suffix, as in my-scenario.yaml"
    raise _unreadable(name_or_path, "there is no such shipped scenario; fleet list shows them all", hint)


def _python_file(path: Path) -> tuple[str, str]:
    """The mistake in giving a Python file in place of a scenario, and a remedy."""
    wrong = "expected a scenario (YAML), got a Python file"
    beside = path.with_suffix(".yaml")
    if beside.exists():
        return wrong, f"did you mean {beside}?"
    return (wrong, f'a scenario names what is in it, as in agent: "{path.stem}:MyAgent"; fleet new writes both')


def _instead(path: Path) -> str:
    """A file or a scenario that ships which may be meant by a file that is not there."""
    other = {".yml": ".yaml", ".yaml": ".yml"}.get(path.suffix)
    if other and path.with_suffix(other).exists():
        return f"did you mean {path.with_suffix(other)}?"
    if path.stem in shipped_scenarios():
        return f"did you mean {path.stem}? The scenarios that ship have no suffix"
    try:
        files = [str(file) for file in path.parent.iterdir() if file.suffix in (".yaml", ".yml")]
    except OSError:
        files = []
    return nearest(str(path), files) or "fleet list lists the scenarios that ship, fleet new scenario NAME writes one"


def _content(path: Path) -> bytes:
    """The bytes of a file, or of an open descriptor: /dev/stdin, or /dev/fd/63 as a shell writes <(command)."""
    if path == Path("/dev/stdin") or path.parent in (Path("/dev/fd"), Path("/proc/self/fd")):
        with path.open("rb") as file:
            return read_bounded(file, SCENARIO.bytes)
    return read_file(path, SCENARIO.bytes)


def _unreadable(name: str, message: str, hint: str = "") -> ScenarioError:
    return ScenarioError([Problem(name or '""', 0, 0, message, hint)])
