"""Signals that the lines of a program tell."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LineSignal:
    """A signal that the lines of a program tell."""

    name: str
    pattern: re.Pattern[str]
    counts: bool = False  # the value is the number of such lines

    def read(self, line: str, before: float | None = None) -> float | None:
        """The value in a line; None: the line is another one.

        Args:
            line: what the program printed.
            before: the value so far.
        """
        found = self.pattern.search(line)
        if found is None:
            return None
        if self.counts:
            return (before or 0.0) + 1.0
        try:
            return float(found["value"])
        except ValueError:
            return None
