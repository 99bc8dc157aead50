"""Which topics are played, and on which keys."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from fleet.errors import FleetError
from netem.parsing import nearest


class SelectionError(FleetError):
    """A pattern, expression or renaming that cannot be used."""


def pattern(text: str) -> re.Pattern[str]:
    """A topic or a pattern of topics in the manner of zenoh's key expressions: `*` is one part, `**` any number.

    https://github.com/eclipse-zenoh/roadmap/blob/main/rfcs/ALL/Key%20Expressions.md
    """
    parts = text.strip("/").split("/")
    built = ""
    for n, part in enumerate(parts):
        last = n == len(parts) - 1
        if part == "**":
            built += "(?:.+)?" if last and n == 0 else "(?:/.+)?" if last else "(?:[^/]+/)*"
        else:
            piece = "[^/]+" if part == "*" else re.escape(part).replace(r"\$\*", "[^/]*")
            after = "" if last or (parts[n + 1] == "**" and n + 1 == len(parts) - 1) else "/"
            built += piece + after
    return re.compile(built)


def chosen(topics: Iterable[str], patterns: Sequence[str], expression: str | None) -> set[str]:
    """The topics that any of the patterns or the regular expression names; all of them without either.

    Raises:
        SelectionError: a pattern or the expression names none.
    """
    known = sorted(set(topics))
    if not patterns and expression is None:
        return set(known)
    found: set[str] = set()
    for text in patterns:
        matching = {topic for topic in known if pattern(text).fullmatch(topic.strip("/"))}
        if not matching:
            hint = nearest(text, known) or f"there are {', '.join(known[:8])}{', ...' if len(known) > 8 else ''}"
            raise SelectionError(f'no topic of the log is called "{text}": {hint}')
        found |= matching
    if expression is not None:
        try:
            compiled = re.compile(expression)
        except re.error as error:
            raise SelectionError(f'"{expression}" is no regular expression: {error}') from None
        matching = {topic for topic in known if compiled.search(topic)}
        if not matching and not found:
            raise SelectionError(f'no topic of the log matches "{expression}"')
        found |= matching
    return found


class Renaming:
    """`OLD:=NEW`, of a topic or of the first parts of many; the longest OLD that fits counts."""

    def __init__(self, rules: Sequence[str]) -> None:
        """Raises SelectionError: a rule is not of that form."""
        self._rules: dict[str, str] = {}
        for rule in rules:
            old, sign, new = rule.partition(":=")
            old, new = old.strip("/"), new.strip("/")
            if not sign or not old or not new:
                raise SelectionError(f'expected OLD:=NEW such as robot:=twin, got "{rule}"')
            if set(new) & set("*$?#") or "" in new.split("/"):
                raise SelectionError(f'"{new}" is no key: it has an empty part, or one of * $ ? #')
            if old in self._rules:
                raise SelectionError(f'"{old}" is renamed twice')
            self._rules[old] = new
        self._unused = set(self._rules)

    def __call__(self, topic: str) -> str:
        """The topic's new name."""
        parts = topic.strip("/").split("/")
        for count in range(len(parts), 0, -1):
            old = "/".join(parts[:count])
            if old in self._rules:
                self._unused.discard(old)
                return "/".join([self._rules[old], *parts[count:]])
        return "/".join(parts)

    def check(self) -> None:
        """Raises SelectionError: a rule has renamed nothing."""
        if self._unused:
            raise SelectionError(f'nothing is played that is called "{min(self._unused)}"')
