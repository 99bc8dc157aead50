"""The topics that are played, and their keys."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from fleet.errors import FleetError
from netem.parsing import nearest
from netem.wire.open_bus import matching


def chosen(topics: Iterable[str], patterns: Sequence[str], expression: str | None) -> set[str]:
    """The topics that any of the patterns or the regular expression names; all of them without either.

    Args:
        patterns: key expressions of zenoh; slashes around them and around topics do not count.
        expression: a regular expression, searched for in every topic.

    Raises:
        FleetError: a pattern or the expression names none.
    """
    known = sorted(set(topics))
    if not patterns and expression is None:
        return set(known)
    names: set[str] = set()
    for text in patterns:
        included = matching(text.strip("/"))
        some = {topic for topic in known if included(topic.strip("/"))}
        if not some:
            hint = nearest(text, known) or f"there are {', '.join(known[:8])}{', ...' if len(known) > 8 else ''}"
            raise FleetError(f'no topic of the log is called "{text}": {hint}')
        names |= some
    if expression is not None:
        try:
            compiled = re.compile(expression)
        except re.error as error:
            raise FleetError(f'"{expression}" is no regular expression: {error}') from None
        some = {topic for topic in known if compiled.search(topic)}
        if not some and not names:
            raise FleetError(f'no topic of the log matches "{expression}"')
        names |= some
    return names


class Renaming:
    """`OLD:=NEW`, of a topic or of the first parts of many; the longest OLD that fits counts."""

    def __init__(self, rules: Sequence[str]) -> None:
        """Raises FleetError: a rule is not of that form."""
        self._rules: dict[str, str] = {}
        for rule in rules:
            old, sign, new = rule.partition(":=")
            old, new = old.strip("/"), new.strip("/")
            if not sign or not old or not new:
                raise FleetError(f'expected OLD:=NEW such as robot:=twin, got "{rule}"')
            if set(new) & set("*$?#") or "" in new.split("/"):
                raise FleetError(f'"{new}" is no key: it has an empty part, or one of * $ ? #')
            if old in self._rules:
                raise FleetError(f'"{old}" is renamed twice')
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
        """Raises FleetError: a rule has renamed nothing."""
        if self._unused:
            raise FleetError(f'nothing is played that is called "{min(self._unused)}"')
