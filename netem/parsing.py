"""What every text of ours is read with: exact numbers, an error with a place, the nearest known word."""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal
from difflib import get_close_matches
from fractions import Fraction

from netem.errors import NetemError

NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,3})?", re.ASCII)
LONGEST_NUMBER = 40  # characters: keeps exact arithmetic cheap whatever the text


class GrammarError(NetemError):
    """Text that is no condition or selector; `column` counts from 0 within the text."""

    def __init__(self, message: str, column: int = 0, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.column = column
        self.hint = hint


def exact_number(text: str) -> Fraction | None:
    """The decimal number that `text` is, exactly, or None: no text, however long, takes long."""
    if len(text) > LONGEST_NUMBER or not NUMBER.fullmatch(text):
        return None
    return Fraction(Decimal(text))


def nearest(word: str, known: Iterable[str]) -> str:
    """`did you mean "delay"?` when one of the known words is near, else nothing."""
    lower = {name.lower(): name for name in known}
    found = get_close_matches(word.lower()[:60], lower, n=1, cutoff=0.6)
    return f'did you mean "{lower[found[0]]}"?' if found else ""


def quoted(text: str) -> str:
    return f'"{text[:40]}"' if text else "nothing"
