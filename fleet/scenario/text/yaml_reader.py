"""A reader of YAML. In its tree every key and value has its place in the text.

It uses libyaml's events rather than PyYAML's loaders, for three reasons. The loaders keep no marks. They read YAML 1.1:
`1e-3` is text, `on` is true, `12:30` is 750, and the last of two equal keys wins. And they recurse without a limit.
Here scalars follow the core schema of YAML 1.2, duplicate keys are mistakes, and depth and size are bounded, so that no
text hangs or crashes the reader.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import yaml

from fleet.errors import Problem
from netem.limits import SCENARIO, SCENARIO_CHARACTERS

try:
    from yaml import CSafeLoader as _Loader
except ImportError:  # pragma: no cover - a PyYAML built without libyaml reads the same, slowly
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]


_BREAK = re.compile("\r\n|[\n\r\x85\u2028\u2029]")  # what YAML 1.1, and so libyaml, calls a line break
_INT = re.compile(r"[-+]?[0-9]{1,18}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WORDS: dict[str, Any] = {"": None, "~": None}
_WORDS |= {word: value for name, value in (("null", None), ("true", True), ("false", False))
           for word in (name, name.capitalize(), name.upper())}  # fmt: skip
_WORDS |= {sign + dot: float(sign + dot[1:]) for sign in ("", "+", "-") for dot in (".inf", ".Inf", ".INF")}
_WORDS |= {dot: float("nan") for dot in (".nan", ".NaN", ".NAN")}


@dataclass(frozen=True)
class Source:
    """A text that is read: a file, or one `--set` argument. `rank` orders the sources of one scenario."""

    name: str
    text: str
    rank: int = 0

    @cached_property
    def lines(self) -> list[str]:
        return _BREAK.split(self.text)

    def line(self, number: int) -> str:
        return self.lines[number - 1] if 0 < number <= len(self.lines) else ""


@dataclass(frozen=True, slots=True)
class TextPlace:
    """A character of a source; line and column count from 1."""

    source: Source
    line: int
    column: int

    def problem(self, message: str, hint: str = "", key: str = "") -> Problem:
        return Problem(self.source.name, self.line, self.column, message, hint, self.source.line(self.line), key)

    def shift(self, columns: int) -> TextPlace:
        return TextPlace(self.source, self.line, self.column + columns)

    @property
    def order(self) -> tuple[int, int, int]:
        return self.source.rank, self.line, self.column


@dataclass(frozen=True, slots=True)
class Scalar:
    """A scalar; `text` is its first character if it stands in the source letter by letter, else None."""

    value: str | int | float | bool | None
    place: TextPlace
    text: TextPlace | None = None


@dataclass(frozen=True, slots=True)
class Items:
    """A sequence."""

    items: tuple[Node, ...]
    place: TextPlace


@dataclass(frozen=True, slots=True)
class Mapping:
    """A mapping; `keys` holds the place of each key."""

    entries: dict[str, Node]
    keys: dict[str, TextPlace]
    place: TextPlace

    def with_entry(self, key: str, key_place: TextPlace, node: Node) -> Mapping:
        """A copy with one entry set, at the end even if the key was there: for link rules the last wins."""
        entries = {k: v for k, v in self.entries.items() if k != key}
        return Mapping(entries | {key: node}, self.keys | {key: key_place}, self.place)

    def without(self, key: str) -> Mapping:
        return Mapping({k: v for k, v in self.entries.items() if k != key}, self.keys, self.place)


Node = Scalar | Items | Mapping


def plain(node: Node) -> Any:
    """The values of a tree without their places."""
    if isinstance(node, Scalar):
        return node.value
    if isinstance(node, Items):
        return [plain(item) for item in node.items]
    return {key: plain(value) for key, value in node.entries.items()}


def locate(root: Node, path: Sequence[str | int], *, key: bool = False) -> TextPlace:
    """The place of the value at `path` (of its key, if `key`), or of its nearest ancestor that exists."""
    node, place = root, root.place
    for step in path:
        if isinstance(node, Mapping) and step in node.entries:
            place = node.keys[str(step)] if key else node.entries[str(step)].place
            node = node.entries[str(step)]
        elif isinstance(node, Items) and isinstance(step, int) and step < len(node.items):
            node = node.items[step]
            place = node.place
        else:
            break
    return place


def text_place(root: Node, path: Sequence[str | int], column: int) -> TextPlace:
    """The place of the character `column` of the text at `path`, as exactly as the source allows."""
    node = root
    for step in path:
        if isinstance(node, Mapping) and step in node.entries:
            node = node.entries[str(step)]
        elif isinstance(node, Items) and isinstance(step, int) and step < len(node.items):
            node = node.items[step]
    if isinstance(node, Scalar) and node.text is not None:
        return node.text.shift(column)
    return locate(root, path)


def resolve(text: str) -> str | int | float | bool | None:
    """The value of a plain scalar, by the core schema of YAML 1.2."""
    if text in _WORDS:
        value: str | int | float | bool | None = _WORDS[text]
        return value
    if _INT.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def read(source: Source, *, start: int = 0) -> tuple[Node | None, list[Problem]]:
    """The tree of the YAML in `source` from character `start` of its first line, and every mistake in it.

    The tree is None if the text is not YAML at all.
    """
    reader = _Reader(source, start)
    try:
        return reader.read(), reader.problems
    except _StopError:
        return None, reader.problems


class _StopError(Exception):
    """Nothing after this point can be read."""


@dataclass
class _Reader:
    source: Source
    start: int
    problems: list[Problem] = field(default_factory=list)
    anchors: dict[str, tuple[Node, int]] = field(default_factory=dict)  # node, its size
    open: set[str] = field(default_factory=set)  # anchors whose node is being read

    def read(self) -> Node | None:
        text = self.source.text[self.start :]
        if len(text) > SCENARIO_CHARACTERS:
            self._fail(None, f"the text is longer than {SCENARIO_CHARACTERS} characters")
        events = self._events(text)
        root: Node | None = None
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                if root is not None:
                    self._fail(event.start_mark, "a second document begins here", "one file holds one scenario")
                root, _ = self._node(next(events), events, 0)
        if root is None:
            self._fail(None, "the text is empty", "fleet new scenario NAME writes a scenario to begin with")
        return root

    def _events(self, text: str) -> Iterator[Any]:
        try:
            yield from yaml.parse(text, Loader=_Loader)
        except yaml.MarkedYAMLError as error:
            if "nesting depth" in (error.problem or ""):  # libyaml's limit is above ours, and it reads ahead
                self._fail(error.problem_mark, f"nested more than {SCENARIO.depth} deep")
            hint = ""
            if "alias" in (error.context or ""):
                hint = 'a text that begins with * or & needs quotes: "*->2"'
            elif "cannot start any token" in (error.problem or ""):
                hint = "tabs cannot indent; a text that begins with @, ` or % needs quotes"
            elif "mapping values are not allowed" in (error.problem or ""):
                hint = "a line is indented more than the one above it, or a text with ': ' needs quotes"
            words = [w for w in (error.problem, error.context) if w]
            self._fail(error.problem_mark or error.context_mark, f"not YAML: {', '.join(words)}", hint)
        except (yaml.YAMLError, UnicodeError) as error:
            reason = getattr(error, "reason", "") or "unreadable characters"
            self._fail(None, f"not YAML: {reason}")

    def _node(self, event: Any, events: Iterator[Any], depth: int) -> tuple[Node, int]:
        """The node that begins with `event`, and how many nodes it stands for."""
        if depth > SCENARIO.depth:
            self._fail(event.start_mark, f"nested more than {SCENARIO.depth} deep")
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event)
        if event.tag is not None and event.tag != "!":
            self._note(event.start_mark, f'tags such as "{event.tag[:40]}" are not used here', "remove it")
        if event.anchor:
            self.open.add(event.anchor)
        if isinstance(event, yaml.ScalarEvent):
            node: Node = self._scalar(event)
            size = 1
        elif isinstance(event, yaml.SequenceStartEvent):
            node, size = self._items(event, events, depth)
        else:
            node, size = self._mapping(event, events, depth)
        if size > SCENARIO.items:
            self._fail(event.start_mark, f"more than {SCENARIO.items} values")
        if event.anchor:
            self.open.discard(event.anchor)
            self.anchors[event.anchor] = node, size
        return node, size

    def _alias(self, event: Any) -> tuple[Node, int]:
        if event.anchor in self.open:
            self._fail(event.start_mark, f'"*{event.anchor}" stands for something that contains it')
        if event.anchor not in self.anchors:
            self._fail(event.start_mark, f'"*{event.anchor}" stands for nothing: no "&{event.anchor}" before it')
        return self.anchors[event.anchor]

    def _scalar(self, event: Any) -> Scalar:
        place = self._place(event.start_mark)
        quoted = event.style in ("'", '"')
        value = event.value if quoted or event.style else resolve(event.value)
        at = place.column - 1 + quoted
        verbatim = self.source.line(place.line)[at : at + len(event.value)] == event.value
        return Scalar(value, place, place.shift(quoted) if verbatim else None)

    def _items(self, event: Any, events: Iterator[Any], depth: int) -> tuple[Items, int]:
        place, items, size = self._place(event.start_mark), [], 1
        while not isinstance(item := next(events), yaml.SequenceEndEvent):
            node, n = self._node(item, events, depth + 1)
            items.append(node)
            size += n
        return Items(tuple(items), place), size

    def _mapping(self, event: Any, events: Iterator[Any], depth: int) -> tuple[Mapping, int]:
        place, size = self._place(event.start_mark), 1
        entries: dict[str, Node] = {}
        keys: dict[str, TextPlace] = {}
        while not isinstance(item := next(events), yaml.MappingEndEvent):
            mark = item.start_mark
            key_node, _ = self._node(item, events, depth + 1)
            value, n = self._node(next(events), events, depth + 1)
            size += n
            key = item.value if isinstance(item, yaml.ScalarEvent) else None
            if isinstance(item, yaml.AliasEvent) and isinstance(key_node, Scalar):
                key = str(key_node.value)
            if key is None:
                self._note(mark, "a key must be a text, got a list or a mapping")
            elif key in entries:
                first = keys[key]
                self._note(mark, f'the key "{key[:40]}" is here twice', f"first at line {first.line}")
            else:
                entries[key], keys[key] = value, self._place(mark)
        return Mapping(entries, keys, place), size

    def _place(self, mark: Any) -> TextPlace:
        column = mark.column + 1 + (self.start if mark.line == 0 else 0)
        return TextPlace(self.source, mark.line + 1, column)

    def _note(self, mark: Any, message: str, hint: str = "") -> None:
        place = self._place(mark) if mark else TextPlace(self.source, 1, 1 + self.start)
        while place.line > 1 and not self.source.line(place.line).strip():  # the end of the text: show its last line
            place = TextPlace(self.source, place.line - 1, len(self.source.line(place.line - 1)) + 1)
        self.problems.append(place.problem(message, hint))

    def _fail(self, mark: Any, message: str, hint: str = "") -> None:
        self._note(mark, message, hint)
        raise _StopError
