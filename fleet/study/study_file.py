"""A study as a file: YAML with the one key `study`. Every mistake is told at once, each where it was written."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from fleet.errors import Problem, ScenarioError, printable
from fleet.quantities import QuantityError, describe_value, time_ns
from fleet.scenario.catalogue import shipped_scenarios
from fleet.scenario.text.plain_yaml import inline
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Scalar, Source, TextPlace, plain, read
from fleet.scenario.trust import TYPED, OverrideOrigin, origin
from fleet.study.catalogue import shipped_studies, study_text
from fleet.study.errors import StudyError
from fleet.study.plan import parse_seeds
from fleet.study.settings import KEEP_LOGS, MOST_ALLOWED
from fleet.study.signals import check_name
from fleet.study.spec import StudySpec, is_file, seeds_text
from fleet.study.stopping import check_until
from fleet.study.values import axis, values_text
from netem.parsing import nearest
from netem.whole_file import read_file

_KEY = "study"
_MAX_BYTES = 4_000_000  # as many as the characters that yaml_reader takes can have


class NamedStudy(NamedTuple):
    """A study that somebody wrote down, and where it comes from."""

    spec: StudySpec
    origin: OverrideOrigin = TYPED


def study_named(name: str) -> NamedStudy | None:
    """The study of a shipped name or of a file; None: it may be the name of a scenario.

    Raises:
        ScenarioError: with every mistake in the file.
        StudyError: the name is nearly that of a study.
    """
    if name in shipped_studies():
        return NamedStudy(parse_study(Source(f"{name}.yaml", study_text(name))))
    path = Path(name)
    if not path.is_file():
        close = nearest(name, shipped_studies())
        if close and name not in shipped_scenarios() and not path.suffix:
            raise StudyError(f"there is no study or scenario {name}; {close}")
        return None
    try:
        source = Source(name, read_file(path, _MAX_BYTES).decode("utf-8-sig"))
    except (OSError, ValueError):  # who reads it as a scenario says what is wrong
        return None
    return NamedStudy(parse_study(source, path.parent), origin(path)) if is_study(source) else None


def refuse_study(name: str) -> None:
    """Refuse a name or a file, where a scenario is needed; a directory is not looked into.

    Raises:
        StudyError: it is a study.
        ScenarioError: it is one with mistakes.
    """
    if not Path(name).is_dir() and study_named(name) is not None:
        raise StudyError(f"{name} is a study, not a scenario: fleet sweep {name} runs it")


def is_study(source: Source) -> bool:
    """Whether a text is a study rather than a scenario."""
    root, _ = read(source)
    return isinstance(root, Mapping) and _KEY in root.entries


def parse_study(source: Source, folder: Path | None = None) -> StudySpec:
    """The study that a text describes.

    Args:
        folder: where the file of a scenario is looked for; None: only scenarios that ship are known.

    Raises:
        ScenarioError: with every mistake that was found, in the order of the text.
    """
    root, problems = read(source)
    reader = _Reader(problems, folder)
    values: dict[str, Any] = {}
    if isinstance(root, Mapping):
        for key in root.entries.keys() - {_KEY}:
            hint = f"keys of the scenario stand in set, below {_KEY}"
            reader.tell(root.keys[key], f'unknown key "{shown(key)}": a study is the one key "{_KEY}"', hint)
        values = reader.study(root.entries.get(_KEY, root))
    elif root is not None:
        reader.expected(f'a mapping with the key "{_KEY}"', root, _KEY)
    if reader.problems:
        raise ScenarioError(sorted(reader.problems, key=lambda problem: (problem.line, problem.column)))
    return StudySpec(**values)


def shown(text: str) -> str:
    """A text of a stranger's file in a message."""
    return printable(text[:60])


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
            "until": self._until,
            "most_seeds": self._count,
            "keep_logs": self._keep_logs,
            "timeout": self._time,
            "budget": self._time,
        }

    def tell(self, place: TextPlace, message: str, hint: str = "") -> None:
        """Tell a mistake."""
        self.problems.append(place.problem(message, hint))

    def study(self, node: Node) -> dict[str, Any]:
        """The values by key; where one is wrong, something of its kind."""
        if not isinstance(node, Mapping):
            self.expected("a mapping with at least a scenario", node, _KEY)
            return {}
        values = {}
        for key, value in node.entries.items():
            if key not in self._keys:
                hint = nearest(key, self._keys) or f"known here: {', '.join(self._keys)}"
                self.tell(node.keys[key], f'unknown key "{shown(key)}"', hint)
            elif not (isinstance(value, Scalar) and value.value is None):
                values[key] = self._keys[key](value, key)
        if "scenario" not in node.entries:
            self.tell(node.place, f'"scenario" is missing in "{_KEY}"', "a shipped name, or a file beside this one")
        return values

    def expected(self, what: str, node: Node, key: str) -> None:
        """Tell that a value is something else."""
        self.tell(node.place, f"{key}: expected {what}, got {describe_value(plain(node))}")

    def _text(self, node: Node, key: str) -> str:
        if isinstance(node, Scalar) and isinstance(node.value, str):
            return self._line(node, key, node.value)
        self.expected("a text", node, key)
        return ""

    def _flag(self, node: Node, key: str) -> bool:
        if isinstance(node, Scalar) and isinstance(node.value, bool):
            return node.value
        self.expected("true or false", node, key)
        return False

    def _whole(self, node: Node, key: str) -> int:
        if isinstance(node, Scalar) and type(node.value) is int and node.value >= 0:
            return node.value
        self.expected("a whole number from 0 on", node, key)
        return 0

    def _scenario(self, node: Node, key: str) -> str:
        name = self._text(node, key)
        return str(self._folder / name) if self._folder is not None and is_file(name, self._folder) else name

    def _time(self, node: Node, key: str) -> str:
        text = self._text(node, key)
        try:
            if text and time_ns(text) < 0:
                self.expected("a time that is not negative", node, key)
        except QuantityError as error:
            self.tell(node.place, f"{key}: {error.message}", error.hint)
        return text

    def _texts(self, node: Node, key: str) -> list[str]:
        return [self._text(item, key) for item in (node.items if isinstance(node, Items) else [node])]

    def _measures(self, node: Node, key: str) -> list[str]:
        names = self._texts(node, key)
        for name, item in zip(names, node.items if isinstance(node, Items) else [node], strict=True):
            if name:
                self._tried(item, partial(check_name, name))
        return names

    def _until(self, node: Node, key: str) -> str:
        text = self._text(node, key)
        if text:
            self._tried(node, partial(check_until, text))
        return text

    def _count(self, node: Node, key: str) -> int:
        if isinstance(node, Scalar) and type(node.value) is int and 1 <= node.value <= MOST_ALLOWED:
            return node.value
        self.expected(f"a whole number from 1 to {MOST_ALLOWED}", node, key)
        return 1

    def _keep_logs(self, node: Node, key: str) -> str:
        if isinstance(node, Scalar) and node.value in KEEP_LOGS:
            return str(node.value)
        self.expected(f"one of {', '.join(KEEP_LOGS)}", node, key)
        return KEEP_LOGS[0]

    def _seeds(self, node: Node, key: str) -> str:
        value = plain(node)
        text = self._line(node, key, seeds_text(value) if isinstance(value, list) else str(value))
        self._tried(node, lambda: parse_seeds(text))
        return text

    def _vary(self, node: Node, key: str) -> dict[str, str]:
        found = {}
        for name, value in self._mapping(node, key).items():
            text = found[name] = self._line(value, key, values_text(plain(value)))
            self._tried(value, partial(axis, name, text))
        return found

    def _set(self, node: Node, key: str) -> dict[str, str]:
        values = {name: (value, plain(value)) for name, value in self._mapping(node, key).items()}
        return {
            name: self._line(value, key, found if isinstance(found, str) else inline(found))
            for name, (value, found) in values.items()
        }

    def _line(self, node: Node, key: str, text: str) -> str:
        """The text of a value, which is shown on terminals."""
        if printable(text) != text:
            self.tell(node.place, f"{key}: a line break or a control character is in it")
        return printable(text)

    def _mapping(self, node: Node, key: str) -> dict[str, Node]:
        if isinstance(node, Mapping):
            return node.entries
        self.expected("a mapping of keys of the scenario to values", node, key)
        return {}

    def _tried(self, node: Node, make: Callable[[], object]) -> None:
        try:
            make()
        except StudyError as error:
            self.tell(node.place, str(error))
