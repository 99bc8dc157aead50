"""The common output of the commands of studies: columns of the varied values, and the status line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from fleet.terminal.status_line import BAR, StatusLine, bar
from fleet.terminal.table import Piece, TerminalColumn, say

if TYPE_CHECKING:
    from fleet.study.record import AxisRecord
    from fleet.study.store import Store
    from fleet.study.sweep import Progress


def axis_columns(axes: Sequence[AxisRecord], rows: Sequence[Mapping[str, float | str]]) -> list[TerminalColumn]:
    """A column for each key that is varied. `rows`: the values of each row of the table by key."""
    columns = []
    for axis in axes:
        heading = axis.key.removeprefix("network.links.") + (f"\n[{axis.unit}]" if axis.unit else "")
        cells = [cell(values[axis.key]) for values in rows]
        columns.append(TerminalColumn(heading, cells, 0, "left" if axis.unit is None else "right"))
    return columns


def cell(value: float | str) -> str:
    """A value of a key that is varied."""
    return value if isinstance(value, str) else f"{value:g}"


def progress_pieces(line: StatusLine, share: float, progress: Progress) -> list[Piece]:
    """How far it is, how fast it goes, and how many runs have no result."""
    rate = f"{progress.rate:.2g} {progress.doing}/s" if progress.new else ""
    failed = f"{progress.failed} without result" if progress.failed else ""
    return [
        Piece(5, [bar(share), bar(share, BAR // 2), ""] if line.live else [""]),
        Piece(3, [rate, ""]),
        Piece(1, [failed, ""]),
    ]


def show_reached(store: Store) -> None:
    """Say what some run had to reach, and whether one did."""
    from fleet.study.summary import reached

    for one in reached(store):
        say(one.words if one.hits else f"{one.words}: that no check fails says little")
