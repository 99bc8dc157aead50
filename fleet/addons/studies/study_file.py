"""A study as a file: YAML with the one key `study`. Every mistake is told at once, each where it was written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from fleet.addons.studies.catalogue import shipped_studies, study_text
from fleet.addons.studies.errors import StudyError
from fleet.addons.studies.option_values import read as read_value
from fleet.addons.studies.spec import StudySpec
from fleet.errors import Problem, ScenarioError, printable
from fleet.option import Kind, OptionField, fields
from fleet.quantities import describe_value
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Scalar, Source, TextPlace, plain, read
from fleet.scenario.text.yaml_writer import inline, yaml_text
from fleet.scenario.trust import TYPED, OverrideOrigin, origin
from netem.files import read_file
from netem.limits import SCENARIO
from netem.parsing import nearest

_KEY = "study"
_NESTED = re.compile(r"\s*[\[{]")


class NamedStudy(NamedTuple):
    """A study that somebody wrote down, and where it comes from."""

    spec: StudySpec
    origin: OverrideOrigin = TYPED


def study_named(name: str) -> NamedStudy | None:
    """The study of a shipped name or of a file; None: it may be the name of a scenario. Raises ScenarioError: with
    every mistake in the file; StudyError: the name is nearly that of a study."""
    if name in shipped_studies():
        return NamedStudy(parse_study(Source(f"{name}.yaml", study_text(name))))
    path = Path(name)
    if not path.is_file():
        close = nearest(name, shipped_studies())
        if close and name not in shipped_scenarios() and not path.suffix:
            raise StudyError(f"there is no study or scenario {name}; {close}")
        return None
    try:
        source = Source(name, read_file(path, SCENARIO.bytes).decode("utf-8-sig"))
    except (OSError, ValueError):  # who reads it as a scenario says what is wrong
        return None
    return NamedStudy(parse_study(source, path.parent), origin(path)) if is_study(source) else None


def refuse_study(name: str) -> None:
    """Refuse a name or a file, where a scenario is needed; a directory is not looked into. Raises StudyError: it is a
    study; ScenarioError: it is one with mistakes."""
    if not Path(name).is_dir() and study_named(name) is not None:
        raise StudyError(f"{name} is a study, not a scenario: fleet sweep {name} runs it")


def is_study(source: Source) -> bool:
    root, _ = read(source)
    return isinstance(root, Mapping) and _KEY in root.entries


def parse_study(source: Source, folder: Path | None = None) -> StudySpec:
    """The study that a text describes. `folder`: where the file of a scenario is looked for; None: only scenarios that
    ship are known. Raises ScenarioError: with every mistake that was found, in the order of the text."""
    root, problems = read(source)
    reader = _Reader(problems, folder)
    values: dict[str, Any] = {}
    if isinstance(root, Mapping):
        for key in root.entries.keys() - {_KEY}:
            hint = f"keys of the scenario stand in set, below {_KEY}"
            reader.tell(root.keys[key], f'unknown key "{printable(key[:60])}": a study is the one key "{_KEY}"', hint)
        values = reader.study(root.entries.get(_KEY, root))
    elif root is not None:
        reader.expected(f'a mapping with the key "{_KEY}"', root, _KEY)
    if reader.problems:
        raise ScenarioError(sorted(reader.problems, key=lambda problem: (problem.line, problem.column)))
    return StudySpec(**values)


class _Reader:
    """Reads the keys of a study, and collects what is wrong."""

    def __init__(self, problems: list[Problem], folder: Path | None) -> None:
        self.problems, self._folder, self._fields = problems, folder, fields(StudySpec)

    def tell(self, place: TextPlace, message: str, hint: str = "") -> None:
        self.problems.append(place.problem(message, hint))

    def expected(self, what: str, node: Node, key: str) -> None:
        self.tell(node.place, f"{key}: expected {what}, got {describe_value(plain(node))}")

    def study(self, node: Node) -> dict[str, Any]:
        if not isinstance(node, Mapping):
            self.expected("a mapping with at least a scenario", node, _KEY)
            return {}
        values = {}
        for key, value in node.entries.items():
            if key not in self._fields:
                hint = nearest(key, self._fields) or f"known here: {', '.join(self._fields)}"
                self.tell(node.keys[key], f'unknown key "{printable(key[:60])}"', hint)
            elif not (isinstance(value, Scalar) and value.value is None):
                values[key] = self._value(self._fields[key], value)
        if "scenario" not in node.entries:
            self.tell(node.place, f'"scenario" is missing in "{_KEY}"', "a shipped name, or a file beside this one")
        return values

    def _value(self, field: OptionField, node: Node) -> Any:
        if field.shape is list:
            return [self._one(field, item) for item in (node.items if isinstance(node, Items) else [node])]
        if field.shape is not dict:
            return self._one(field, node)
        if isinstance(node, Mapping):
            return {key: self._one(field, value, key) for key, value in node.entries.items()}
        self.expected("a mapping of keys of the scenario to values", node, field.name)
        return {}

    def _one(self, field: OptionField, node: Node, key: str = "") -> Any:
        try:
            value = read_value(field, plain(node), key)
        except StudyError as error:
            self.tell(node.place, f"{field.name}: {error}")
            return None
        if field.kind is Kind.SCENARIO and self._folder is not None and is_file(value, self._folder):
            return str(self._folder / value)
        return value


def study_yaml(spec: StudySpec) -> str:
    """The text of a study as a file, which may stand anywhere on this machine."""
    values = msgspec.to_builtins(with_whole_path(spec))
    values["seeds"] = int(spec.seeds) if spec.seeds.isdecimal() else spec.seeds
    if spec.set:
        values["set"] = {key: _parse_nested(text) for key, text in spec.set.items()}
    for key in ("net", "fault"):
        if len(values.get(key, ())) == 1:
            (values[key],) = values[key]
    return yaml_text({_KEY: {key: values[key] for key in spec.__struct_fields__ if key in values}})


def with_whole_path(spec: StudySpec) -> StudySpec:
    """The same study with the whole path of the scenario's file, so that it holds in every directory."""
    if not is_file(spec.scenario):
        return spec
    return msgspec.structs.replace(spec, scenario=str(Path(spec.scenario).resolve()))


def is_file(scenario: str, folder: Path = Path()) -> bool:
    """Whether the name of a scenario means a file in this folder rather than a shipped one."""
    if scenario in shipped_scenarios():
        return False
    return bool(Path(scenario).suffix) or "/" in scenario or (folder / scenario).exists()


def _parse_nested(text: str) -> Any:
    if _NESTED.match(text):
        node, problems = read(Source("", text))
        if not problems and isinstance(node, Mapping | Items) and inline(plain(node)) == text:
            return plain(node)
    return text
