"""Helpers for every reader of text: exact numbers, the nearest known word."""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal
from difflib import get_close_matches
from fractions import Fraction

NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,3})?", re.ASCII)
LONGEST_NUMBER = 40  # characters: keeps exact arithmetic cheap whatever the text


def exact_number(text: str) -> Fraction | None:
    """The exact value of a decimal number; None if `text` is none, or has more than 40 characters."""
    if len(text) > LONGEST_NUMBER or not NUMBER.fullmatch(text):
        return None
    return Fraction(Decimal(text))


def nearest(word: str, known: Iterable[str], likeness: float = 0.6) -> str:
    """`did you mean "delay"?` when one of the known words is near, else nothing. A likeness of 1 is the same word."""
    lower = {name.lower(): name for name in known}
    close = get_close_matches(word.lower()[:60], lower, n=1, cutoff=likeness)
    return f'did you mean "{lower[close[0]]}"?' if close else ""


def quoted(text: str) -> str:
    """The first 40 characters of a text in quotation marks, for an error; `nothing` for an empty text."""
    return f'"{text[:40]}"' if text else "nothing"
