"""How wide output is: on a terminal lines are folded between words; elsewhere they stay whole, and tables are wide."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, TextIO

import click

from fleet.errors import harmless

if TYPE_CHECKING:
    from rich.console import Console as Terminal

TABLES = 120  # characters where stdout is no terminal
_UNKNOWN = 80  # the width of a terminal that does not say
INDENT = "  "  # indent of the lines behind a fold


def stdout() -> Terminal:
    """Where tables for stdout are printed."""
    from rich.console import Console as Terminal

    return Terminal(width=None if sys.stdout.isatty() else TABLES, highlight=False)


def say(text: str, *, err: bool = False) -> None:
    """Print lines on stdout, or on stderr."""
    stream = sys.stderr if err else sys.stdout
    click.echo(fold(text, _width(stream) if stream.isatty() else None), err=err)


def fold(text: str, width: int | None, indent: str = INDENT) -> str:
    """Lines folded between words; a word that is longer, a path for instance, stays whole.

    `width`: in characters; None: nothing is folded. `indent`: of the lines that go on, behind the indent of the line
    itself.
    """
    text = harmless(text)
    if width is None:
        return text
    from textwrap import TextWrapper

    lines = []
    for line in text.split("\n"):
        own = line[: len(line) - len(line.lstrip())]
        wrapper = TextWrapper(
            width, subsequent_indent=own + indent, break_long_words=False, break_on_hyphens=False, tabsize=1
        )
        lines += wrapper.wrap(line) or [""]
    return "\n".join(lines)


def _width(stream: TextIO) -> int:
    columns = os.environ.get("COLUMNS", "")
    if columns.isascii() and columns.isdigit() and int(columns):
        return int(columns)
    try:
        return os.get_terminal_size(stream.fileno()).columns or _UNKNOWN
    except OSError:
        return _UNKNOWN
