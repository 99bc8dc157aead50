"""Tables that fit a width: the least important columns are left out, and no heading and no cell is cut."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fleet.errors import harmless
from fleet.terminal.width import fold

if TYPE_CHECKING:
    from rich.console import Console as Terminal


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


def shown_rows(count: int, most: int) -> int:
    """How many of some rows are shown: `most`, or all if one alone were left, whose place its mention would take."""
    return count if count <= most + 1 else most


def width(columns: Sequence[TerminalColumn]) -> int:
    """How wide these are as a table."""
    return sum(column.width for column in columns) + _GAP * (len(columns) - 1)


def fitting(columns: Sequence[TerminalColumn], most: int) -> list[TerminalColumn]:
    """The columns that have room in `most` characters; those of rank 0 in any case."""
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
    before = terminal.width
    if not terminal.is_terminal:  # a file has room for what must be there
        terminal.width = max(before, width(kept))
    terminal.print(made)
    terminal.width = before
    if left := [column.heading.replace("\n", " ") for column in wanted if column not in kept]:
        text = f"left out at {terminal.width} columns: {', '.join(left)} ({elsewhere})"
        terminal.print(fold(text, most), markup=False, highlight=False, soft_wrap=True)
