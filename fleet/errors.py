"""The errors that several rooms of `fleet` raise.

Each package has one base: `FleetError`, `AgentError`, `NetemError`, `WorldError`. An error keeps its data in
fields, so that a caller can print its own words.

`HungUp` stands for a signal, and `OutputError` means that nothing can be printed: neither is caught with `FleetError`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

_WIDTH = 100  # characters of a source line shown around the caret
MOST_SHOWN = 200  # problems of one scenario; more are only counted


class FleetError(Exception):
    """An error of this package, or the base of the errors that callers catch by name.

    `status` is the exit status of `fleet`: 2 if the user should ask for something else, 3 if the machine cannot do what
    the user rightly asked (a full disk, a process that does not start).
    """

    status = 2

    def __init__(self, message: str = "", status: int | None = None) -> None:
        super().__init__(message)
        if status is not None:
            self.status = status


class StoppedError(FleetError):
    """An operator stopped the run."""


class RunBroken(FleetError):
    """A run that cannot go on: a process ended or did not become ready, or nothing moves. `lines` explain it."""

    status = 3

    def __init__(self, reason: str, lines: Sequence[str] = ()) -> None:
        super().__init__(reason)
        self.reason = reason
        self.lines = list(lines)


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a scenario.

    `file` is a path, or the whole argument (`--set seed=x`) when an override holds the mistake. `line` and
    `column` count from 1, in characters; 0 means that the problem has no place (a file that cannot be read).
    """

    file: str
    line: int
    column: int
    message: str  # what is wrong: expected against got
    hint: str = ""  # what to do next
    source_line: str = ""
    key: str = ""  # key of the scenario, as `--set` writes it; "" where the text has no keys yet

    def __str__(self) -> str:
        override = self.file.startswith("--")
        place = "" if override or not self.line else f":{self.line}:{self.column}"
        text = f"{self.file}{place}: {self.message}"
        if self.source_line:
            shown, caret = _window(self.source_line, self.column)
            number = "" if override else str(self.line)
            text += f"\n{number:>5} | {shown}\n      | {' ' * caret}^"
        if self.hint:
            text += f"\n        {self.hint}"
        return text


class ScenarioError(FleetError):
    """A scenario that cannot be run; `problems` holds every mistake found, in the order of the file."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__(str(self))

    def __str__(self) -> str:
        count = len(self.problems)
        tail = f"\n{count} problems" if count > 1 else ""
        if count > MOST_SHOWN:
            tail += f"; the first {MOST_SHOWN} are shown"
        return "\n".join(str(problem) for problem in self.problems[:MOST_SHOWN]) + tail


# Control characters but line breaks and tabs, and those that turn the direction of writing.
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def harmless(text: str, *, json: bool = False) -> str:
    """The same lines without what a terminal obeys; in JSON as escapes. All that is printed goes through this, since
    names in the files of others may hold anything.
    """
    return _OBEYED.sub(lambda found: f"\\u{ord(found[0]):04x}" if json else "\ufffd", text)


def describe_error(error: BaseException) -> str:
    """The kind of an error that somebody else's code has raised, and what it says if it can say it."""
    try:
        return harmless(f"{type(error).__name__}: {error}")
    except Exception:
        return harmless(f"{type(error).__name__}, whose text cannot be made")


def printable(text: str) -> str:
    """The same text without line breaks and control characters, so that a terminal does not obey a foreign text."""
    return "".join(c if c.isprintable() else "\ufffd" for c in text)


def _window(line: str, column: int) -> tuple[str, int]:
    """The part of a long line around the caret, and the caret's index in it."""
    line = "".join(c if c.isprintable() else " " for c in line)
    start = max(0, column - 1 - _WIDTH // 2) if len(line) > _WIDTH else 0
    return line[start : start + _WIDTH].rstrip(), column - 1 - start
