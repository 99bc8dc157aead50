"""Faults and link conditions in words, as `fleet inject` and the options `--fault` and `--net` take them.

    FAULT  := { at TIME | for TIME | id NAME } KIND TARGET       in any order: TIME and NAME may also stand at the end
    TARGET := SELECTOR CONDITION [, SELECTOR CONDITION ...]      of a link; `netem.grammar`, `netem.link_selector`
            | KEY=VALUE ...                                      of noise, slow, gust and others with several values
            | what a scenario has behind the kind                of the others, as in kill 3 or partition 1,2 / 3,4

A unit may stand apart from its number. Quotation marks and braces are not needed, and mean nothing; `:` may stand for
`=` and behind a selector. So a log's text for a fault, such as `noise {vehicles: 2, position_noise: 0.1 m}`, is read as
the same fault.
"""

from __future__ import annotations

import json
import re
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from pydantic import ValidationError

from fleet.errors import FleetError, Problem
from fleet.quantities import TIME
from fleet.scenario.faults.kinds import KINDS
from fleet.scenario.sections.fault_entry import DIVERGED, TUMBLED, entry_of, fault_reader
from fleet.scenario.sections.node_names import values_to_numbers
from fleet.scenario.text.yaml_reader import Mapping, Node, Scalar, Source, TextPlace, plain
from netem.parsing import exact_number, nearest, quoted

MOST_WORDS = 65536  # characters of a fault
_WORD = re.compile(r"[^\s'\"{}]+")
_KEY = re.compile(r"([a-z_]+)[=:]")


class FaultWordsError(FleetError):
    """Words that are no fault or no condition of links, or an override that cannot be applied."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(f"{problem.message}; {problem.hint}" if problem.hint else problem.message)
        self.problem = problem  # with the place of the words at fault


def read_fault(text: str) -> dict[str, Any]:
    """A fault as an entry of a scenario's `faults`, its values as text; whether they are right is not checked.

    Raises FaultWordsError: the text has no kind of fault, or no target.
    """
    found: dict[str, Any] = plain(fault_entry(Source("fault", text)))
    return found


@lru_cache(4096)  # most logs have each twice: a fault begins and ends
def entry_of_words(words: str, names: tuple[str, ...] = ()) -> str:
    """The entry of a fault of which only the words are known, as in a log or in the test of a check. `names`: of the
    nodes. "": these words are no fault.
    """
    if len(words) > MOST_WORDS:  # a log may be of a stranger
        return ""
    kind, _, who = words.partition(" ")
    if kind in (TUMBLED, DIVERGED):
        return json.dumps({kind: who})
    try:
        # The keys stay as they are: a node may be called `kill`.
        read = {key: values_to_numbers(value, names) for key, value in read_fault(words).items()}
        return entry_of(fault_reader().validate_python(read))
    except (FaultWordsError, ValidationError, KeyError):
        return ""


def fault_entry(source: Source) -> Mapping:
    """The same as a tree; every key and value has its place in the source. Raises as `read_fault`."""
    return _Reader(source).fault()


def link_entries(source: Source) -> Mapping:
    """Selectors and conditions in words such as `1->2 delay 100ms, 2->1 down`, as entries of `network.links`.

    Raises FaultWordsError: a selector has no condition.
    """
    return _Reader(source).links()


def example(kind: str) -> str:
    """A fault of this kind in words."""
    return KINDS[kind].example


class _Word(NamedTuple):
    text: str
    column: int  # from 0


@dataclass
class _Reader:
    """The words of a text that are not read yet."""

    source: Source

    def __post_init__(self) -> None:
        self.words = deque(_Word(match.group(), match.start()) for match in _WORD.finditer(self.source.text))

    def fault(self) -> Mapping:
        fault = self._times_and_name()
        if not self.words:
            raise self._wrong(None, "expected a fault, got nothing", f"as in {example('partition')}")
        kind = self.words.popleft()
        if kind.text not in KINDS:
            hint = nearest(kind.text, tuple(KINDS)) or f"there are {', '.join(KINDS)}"
            raise self._wrong(kind, f'no fault is called "{kind.text[:40]}"', hint)
        return self._with_new(fault, kind.text, kind, self._target(kind))

    def _times_and_name(self) -> Mapping:
        """Take `at`, `for` and `id` with their values out of the words."""
        found, rest = self._nothing(), deque[_Word]()
        while self.words:
            word = self.words.popleft()
            if word.text not in ("at", "for", "id"):
                rest.append(word)
                continue
            value = [self.words.popleft()] if self.words else []
            if value and exact_number(value[0].text) is not None and self.words and self.words[0].text in TIME.units:
                value.append(self.words.popleft())
            what = "a name" if word.text == "id" else "a time"
            found = self._with_new(found, word.text, word, self._value(word, value, what))
        self.words = rest
        return found

    def _target(self, kind: _Word) -> Node:
        if kind.text == "link":
            return self.links(kind)
        found = KINDS[kind.text]
        if found.section is not None and (not found.one_word or any(_KEY.match(word.text) for word in self.words)):
            return self._pairs(kind)
        if not self.words:
            raise self._wrong(kind, f"{kind.text} of what?", f"as in {example(kind.text)}")
        return self._scalar(list(self.words))

    def links(self, kind: _Word | None = None) -> Mapping:
        """Conditions by selectors; `kind` is the word before them."""
        found = self._nothing()
        while self.words or not found.entries:
            selector, condition = list[_Word](), list[_Word]()
            while self.words and not (selector and self.words[0].text[0].isalpha()):
                selector.append(self.words.popleft())
            while self.words and not (condition and condition[-1].text.endswith(",")):
                condition.append(self.words.popleft())
            if not condition:
                raise self._incomplete(kind, selector)
            name = " ".join(word.text for word in selector).removesuffix(":")
            found = self._with_new(found, name, selector[0], self._scalar(condition))
        return found

    def _incomplete(self, kind: _Word | None, selector: list[_Word]) -> FaultWordsError:
        """Of a condition the links are missing, or of links the condition."""
        given = " ".join(word.text for word in selector)
        before = "link " if kind else ""
        if given[:1].isalpha():
            form = f"expected links and their condition, got only the condition {quoted(given)}"
            hint = f"as in {before}* {given} for every link, or {before}1->2 {given} for one"
        elif given:
            form = f"expected links and their condition, got only the links {quoted(given)}"
            hint = f"as in {before}{given} loss 30%"
        else:
            form, hint = "expected links and their condition, got nothing", f"as in {before}1->2 loss 30%"
        return self._wrong(selector[0] if selector else kind, form, hint)

    def _pairs(self, kind: _Word) -> Mapping:
        """Values by keys."""
        found = self._nothing()
        while self.words or not found.entries:
            word = self.words.popleft() if self.words else kind
            key = _KEY.match(word.text)
            if word is kind or key is None:
                form = f"a {kind.text} fault is: {kind.text} KEY=VALUE ..."
                raise self._wrong(word, form, f"as in {example(kind.text)}")
            value = [_Word(word.text[key.end() :], word.column + key.end())] if key.end() < len(word.text) else []
            while self.words and not _KEY.match(self.words[0].text):
                value.append(self.words.popleft())
            found = self._with_new(found, key[1], word, self._value(word, value, "a value"))
        return found

    def _value(self, word: _Word, value: list[_Word], what: str) -> Scalar:
        """The words behind a word as one value."""
        if not value:
            raise self._wrong(word, f'expected {what} behind "{word.text[:40]}", got nothing')
        return self._scalar(value)

    def _scalar(self, words: list[_Word]) -> Scalar:
        text, place = " ".join(word.text for word in words).removesuffix(","), self._place(words[0])
        return Scalar(text, place, place if self.source.text.startswith(text, words[0].column) else None)

    def _with_new(self, found: Mapping, key: str, word: _Word, value: Node) -> Mapping:
        if key in found.entries:
            raise self._wrong(word, f'"{key[:40]}" is given twice')
        return found.with_entry(key, self._place(word), value)

    def _nothing(self) -> Mapping:
        return Mapping({}, {}, self._place(None))

    def _place(self, word: _Word | None) -> TextPlace:
        return TextPlace(self.source, 1, 1 if word is None else word.column + 1)

    def _wrong(self, word: _Word | None, message: str, hint: str = "") -> FaultWordsError:
        return FaultWordsError(self._place(word).problem(message, hint))
