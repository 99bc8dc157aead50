"""Names of nodes in selectors, where a scenario of vehicles has numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from fleet.scenario.schema.nodes import RESERVED

# Keys whose values are no selectors. `programs` is that of checks: it names nodes and programs by patterns.
FREE = ("id", "name", "modem", "site", "preset", "trace", "topic", "mode", "aims", "pick", "programs")
_NUMBERS = re.compile(r"(isolate:\s*)?[\d\s,/<>*-]+", re.ASCII)
_SELECTOR = re.compile(r"[\w\s,/<>*:.-]+", re.ASCII)


def to_numbers(text: str, names: Sequence[str]) -> str:
    """A selector with numbers in place of names; any other text as it is. Raises KeyError: it is a selector with a
    name that there is not.
    """
    pattern = _word(tuple(names))
    words = pattern.findall(text)
    if not any(word in names for word in words) or not _SELECTOR.fullmatch(text):
        return text
    for word in words:
        if word not in names and word not in RESERVED:
            raise KeyError(word)
    return pattern.sub(lambda found: found[0] if found[0] in RESERVED else str(names.index(found[0]) + 1), text)


@cache
def _word(names: tuple[str, ...]) -> re.Pattern[str]:
    """A name, the longest one that fits, or a word that is none. The - of `a-b` stands between two names, and that of
    `a-1` belongs to a word, as every dot does.
    """
    longest = sorted(map(re.escape, names), key=len, reverse=True)
    return re.compile(rf"(?<!\w)(?:{'|'.join(longest)})(?![\w.]|-\d)|[A-Za-z]\w*(?:-\d\w*|\.\w+)*", re.ASCII)


def values_to_numbers(value: Any, names: Sequence[str]) -> Any:
    """An entry of a section as plain values, with numbers in place of names. Raises KeyError as `to_numbers`."""
    return _each(value, lambda text: to_numbers(text, names))


def values_to_names(value: Any, names: Sequence[str]) -> Any:
    """The inverse."""
    return _each(value, lambda text: to_names(text, names) if _NUMBERS.fullmatch(text) else text)


def _each(value: Any, change: Callable[[str], str]) -> Any:
    if isinstance(value, str):
        return change(value)
    if isinstance(value, list):
        return [_each(one, change) for one in value]
    if isinstance(value, dict):
        return {change(key): one if key in FREE else _each(one, change) for key, one in value.items()}
    return value


def to_names(text: str, names: Sequence[str]) -> str:
    """The inverse of `to_numbers`, for a selector with numbers that the schema has read; ranges stay numbers."""
    if not names or re.search(r"\d-\d", text):
        return text
    return re.sub(r"\d+", lambda found: names[int(found[0]) - 1] if 0 < int(found[0]) <= len(names) else found[0], text)
