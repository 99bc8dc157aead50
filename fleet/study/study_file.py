"""A study as a file: YAML with the one key `study`. Every mistake is told at once, each where it was written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from fleet.errors import Problem, ScenarioError, printable
from fleet.quantities import QuantityError, describe_value, time_ns
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Place, Scalar, Source, plain, read
from fleet.scenario.text.yaml_writer import inline
from fleet.scenario.trust import stranger
from fleet.study.catalogue import shipped_studies, study_text
from fleet.study.errors import StudyError
from fleet.study.measures import chosen
from fleet.study.plan import parse_seeds
from fleet.study.spec import StudySpec, is_file, values_text
from fleet.study.values import axis
from netem.parsing import nearest
from netem.whole_file import read_file

_KEY = "study"
_MAX_BYTES = 4_000_000  # as many as the characters that yaml_reader takes can have


class NamedStudy(NamedTuple):
    """A study that somebody wrote down.

    Attributes:
        stranger: why laws that are not installed need trust; empty: it ships, or is the user's own.
    """

    spec: StudySpec
    stranger: str = ""


def study_named(name: str) -> NamedStudy | None:
    """The study of a shipped name or of a file; None: the name means no study.

    Raises:
        ScenarioError: with every mistake in the file.
    """
    if name in shipped_studies():
        return NamedStudy(_spec(Source(f"{name}.yaml", study_text(name)), None))
    path = Path(name)
    if not path.is_file():
        return None
    try:
        source = Source(name, read_file(path, _MAX_BYTES).decode("utf-8-sig"))
    except (OSError, ValueError):  # whoever reads it as a scenario says why
        return None
    if not _is_study(source):
        return None
    return NamedStudy(_spec(source, path.parent), stranger(path))


def _is_study(source: Source) -> bool:
    root, _ = read(source)
    return isinstance(root, Mapping) and _KEY in root.entries


def _spec(source: Source, folder: Path | None) -> StudySpec:
    root, problems = read(source)
    assert isinstance(root, Mapping)
    reader = _Reader(problems, folder)
    for key, place in root.keys.items():
        if key != _KEY:
            hint = f"what changes the scenario stands below {_KEY}, in set" if key in root.entries else ""
            reader.tell(place, f'unknown key "{key[:60]}": the file of a study has the one key "{_KEY}"', hint)
    values = reader.study(root.entries[_KEY])
    if reader.problems:
        raise ScenarioError(sorted(reader.problems, key=lambda problem: (problem.line, problem.column)))
    return StudySpec(**values)


class _Reader:
    """Reads the keys of a study, and collects what is wrong."""

    def __init__(self, problems: list[Problem], folder: Path | None) -> None:
        self.problems, self._folder = problems, folder
        self._keys: dict[str, Callable[[Node, str], Any]] = {
            "title": self._text,
            "scenario": self._scenario,
            "run_takes": self._time,
            "vary": self._vary,
            "zip": self._flag,
            "seeds": self._seeds,
            "draw": self._whole,
            "set": self._set,
            "net": self._texts,
            "fault": self._texts,
            "measures": self._measures,
            "timeout": self._time,
        }

    def tell(self, place: Place, message: str, hint: str = "") -> None:
        self.problems.append(place.problem(message, hint))

    def study(self, node: Node) -> dict[str, Any]:
        """The values by key; where one is wrong, something of its kind."""
        if not isinstance(node, Mapping):
            self._expected("a mapping with at least a scenario", node, _KEY)
            return {}
        values = {}
        for key, value in node.entries.items():
            if key not in self._keys:
                hint = nearest(key, self._keys) or f"known here: {', '.join(self._keys)}"
                self.tell(node.keys[key], f'unknown key "{key[:60]}"', hint)
            elif not (isinstance(value, Scalar) and value.value is None):
                values[key] = self._keys[key](value, key)
        if "scenario" not in node.entries:
            self.tell(node.place, f'"scenario" is missing in "{_KEY}"', "a shipped name, or a file beside this one")
        return values

    def _expected(self, what: str, node: Node, key: str) -> None:
        self.tell(node.place, f"{key}: expected {what}, got {describe_value(plain(node))}")

    def _text(self, node: Node, key: str) -> str:
        if isinstance(node, Scalar) and isinstance(node.value, str) and printable(node.value) == node.value:
            return node.value
        self._expected("a text", node, key)
        return ""

    def _flag(self, node: Node, key: str) -> bool:
        if isinstance(node, Scalar) and isinstance(node.value, bool):
            return node.value
        self._expected("true or false", node, key)
        return False

    def _whole(self, node: Node, key: str) -> int:
        if isinstance(node, Scalar) and type(node.value) is int and node.value >= 0:
            return node.value
        self._expected("a whole number from 0 on", node, key)
        return 0

    def _scenario(self, node: Node, key: str) -> str:
        name = self._text(node, key)
        return str(self._folder / name) if self._folder is not None and is_file(name, self._folder) else name

    def _time(self, node: Node, key: str) -> str:
        text = self._text(node, key)
        try:
            if text and time_ns(text) < 0:
                self._expected("a time that is not negative", node, key)
        except QuantityError as error:
            self.tell(node.place, f"{key}: {error.message}", error.hint)
        return text

    def _texts(self, node: Node, key: str) -> list[str]:
        return [self._text(item, key) for item in (node.items if isinstance(node, Items) else [node])]

    def _measures(self, node: Node, key: str) -> list[str]:
        names = self._texts(node, key)
        for name, item in zip(names, node.items if isinstance(node, Items) else [node], strict=True):
            self._tried(item, lambda name=name: chosen([name] if name else []))
        return names

    def _seeds(self, node: Node, key: str) -> str:
        value = plain(node)
        if isinstance(value, list):
            value = ",".join(map(str, [*value, *value[:1]]))  # one alone would be how many
        text = str(value)
        self._tried(node, lambda: parse_seeds(text))
        return text

    def _vary(self, node: Node, key: str) -> dict[str, str]:
        found = {}
        for name, value in self._mapping(node, key).items():
            text = found[name] = values_text(plain(value))
            self._tried(value, lambda name=name, text=text: axis(name, text))
        return found

    def _set(self, node: Node, key: str) -> dict[str, str]:
        values = {name: plain(value) for name, value in self._mapping(node, key).items()}
        return {name: value if isinstance(value, str) else inline(value) for name, value in values.items()}

    def _mapping(self, node: Node, key: str) -> dict[str, Node]:
        if isinstance(node, Mapping):
            return node.entries
        self._expected("a mapping of keys of the scenario to values", node, key)
        return {}

    def _tried(self, node: Node, make: Callable[[], object]) -> None:
        try:
            make()
        except StudyError as error:
            self.tell(node.place, str(error))
