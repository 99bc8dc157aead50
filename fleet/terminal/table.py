"""Tables that fit a width: the least important columns are left out, and no heading and no cell is cut."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import TYPE_CHECKING, Literal, TextIO

import click

from fleet.errors import harmless

if TYPE_CHECKING:
    from rich.console import Console as Terminal


# --- fitting
# One line of several pieces, fitted to a width: the least important are shortened and left out first.


GAP = "  "  # between pieces


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of a line.

    Args:
        rank: 0 is the most important.
        forms: what it may read, the longest first; "" as the last: it may be left out.
    """

    rank: int
    forms: Sequence[str]


def fit(pieces: Sequence[Piece], width: int | None = None) -> str:
    """The pieces in their order, with GAP between them, in at most so many characters.

    First it shortens and then drops optional pieces, beginning with the least important one, until the line fits. Then
    it shortens all other pieces step by step. Only if that is not enough, it drops these, too. Remaining room goes to
    the required pieces, then to as many optional ones as possible, by rank.

    `width`: in characters; None: no limit.
    """
    chosen = [piece.forms[0] for piece in pieces]
    if width is None:
        return _joined(chosen)

    def fits(k: int, form: str) -> bool:
        return len(_joined([*chosen[:k], form, *chosen[k + 1 :]])) <= width

    rising = sorted(range(len(pieces)), key=lambda k: pieces[k].rank)
    needed = [k for k in rising if pieces[k].forms[-1]]
    others = [k for k in rising if not pieces[k].forms[-1]]
    steps = [(k, form) for k in reversed(others) for form in pieces[k].forms]
    most = max((len(pieces[k].forms) for k in needed), default=0)
    steps += [(k, pieces[k].forms[n]) for n in range(most) for k in reversed(needed) if n < len(pieces[k].forms)]
    steps += [(k, "") for k in reversed(needed)]
    for k, form in steps:
        if len(_joined(chosen)) > width:
            chosen[k] = form
    for k in needed:
        chosen[k] = next(form for form in (*pieces[k].forms, chosen[k]) if fits(k, form))
    if all(chosen[k] for k in needed):
        for k in others:
            shortest = [form for form in pieces[k].forms if form][-1:]
            chosen[k] = next(form for form in (*shortest, chosen[k]) if fits(k, form))
        for k in others:
            chosen[k] = next(form for form in (*pieces[k].forms, chosen[k]) if fits(k, form))
    return _joined(chosen)


def shortened(text: str, *widths: int) -> list[str]:
    """The beginnings of a text, of at most so many characters each and whole words: forms of a piece."""
    return [shorten(text, width, placeholder=" ...") for width in widths]


def _joined(forms: Sequence[str]) -> str:
    return GAP.join(filter(None, forms))


# --- folding
# How wide output is: on a terminal lines are folded between words; elsewhere they stay whole, and tables are wide.


TABLES = 120  # characters where stdout is no terminal
_UNKNOWN = 80  # of a terminal that does not say
INDENT = "  "  # of the second line of what is folded, and of all after it


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


_GAP = 2  # spaces between columns


@dataclass(frozen=True, slots=True)
class TerminalColumn:
    """One column of a table.

    Args:
        heading: of one or several lines.
        rank: 0: always there; of the others those with the highest rank are left out first.
    """

    heading: str
    cells: Sequence[str]
    rank: int = 0
    justify: Literal["left", "right"] = "right"

    @property
    def width(self) -> int:
        """Characters of the longest line."""
        return max(len(line) for text in (self.heading, *self.cells) for line in text.split("\n"))


def width(columns: Sequence[TerminalColumn]) -> int:
    """How wide these are as a table."""
    return sum(column.width for column in columns) + _GAP * (len(columns) - 1)


def fitting(columns: Sequence[TerminalColumn], most: int) -> list[TerminalColumn]:
    """The columns that have room in so many characters; those of rank 0 in any case."""
    kept = list(columns)
    for column in sorted(columns, key=lambda column: -column.rank):
        if column.rank and width(kept) > most:
            kept.remove(column)
    return kept


def columns(headings: Mapping[str, int], rows: Iterable[Sequence[str]]) -> list[TerminalColumn]:
    """Columns of these headings and ranks; of each row a cell per heading."""
    cells = list(zip(*rows, strict=True)) or [()] * len(headings)
    return [TerminalColumn(heading, of, rank) for (heading, rank), of in zip(headings.items(), cells, strict=True)]


def show(wanted: Sequence[TerminalColumn], title: str, terminal: Terminal, elsewhere: str) -> None:
    """Print the columns that have room, and where the others are. `elsewhere`: what has all figures, in words."""
    from rich.markup import escape
    from rich.table import Table
    from rich.text import Text

    most = terminal.width if terminal.is_terminal else None
    kept = fitting(wanted, terminal.width)
    # Not the title of the Table: that is folded to the width of the columns.
    terminal.print(Text(fold(title, most), "table.title"), soft_wrap=True)
    made = Table(box=None, pad_edge=False)
    for column in kept:
        made.add_column(escape(harmless(column.heading)), justify=column.justify, vertical="bottom", overflow="fold")
    for row in zip(*(column.cells for column in kept), strict=True):
        made.add_row(*(escape(harmless(cell)) for cell in row))
    terminal.print(made)
    if left := [column.heading.replace("\n", " ") for column in wanted if column not in kept]:
        text = f"no room here for {', '.join(left)}: {elsewhere}"
        terminal.print(fold(text, most), markup=False, highlight=False, soft_wrap=True)
