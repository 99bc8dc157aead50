"""Signals that the lines of a program tell."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LineSignal:
    """A signal that the lines of a program tell."""

    name: str
    pattern: re.Pattern[str]

    def read(self, line: str) -> float | None:
        """The value in a line; None: the line is another one."""
        found = self.pattern.search(line)
        try:
            return None if found is None else float(found["value"])
        except ValueError:
            return None
