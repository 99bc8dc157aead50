"""A table fits its width by leaving out columns, and cuts nothing."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console as Terminal

from fleet.terminal.table import TerminalColumn, columns, fitting, show, shown_rows, width
from fleet.terminal.width import say

COLUMNS = [
    TerminalColumn("link", ["1->2", "2->1"], justify="left"),
    TerminalColumn("delivered", ["12", "9"]),
    TerminalColumn("mean\nage [s]", ["0.1", "0.25"], 2),
    TerminalColumn("p95\n[s]", ["0.1", "0.25"], 3),
    TerminalColumn("max\n[s]", ["1.1", "2.25"], 1),
]


def printed(wanted: list[TerminalColumn], most: int) -> list[str]:
    out = io.StringIO()
    show(wanted, "", Terminal(file=out, width=most), "see result.json")
    return [line.rstrip() for line in out.getvalue().splitlines() if line.strip()]


def test_columns_are_left_out_by_rank() -> None:
    assert printed(COLUMNS, 80) == [
        "                    mean   p95   max",
        "link  delivered  age [s]   [s]   [s]",
        "1->2         12      0.1   0.1   1.1",
        "2->1          9     0.25  0.25  2.25",
    ]
    assert printed(COLUMNS, 24) == [
        "                  max",
        "link  delivered   [s]",
        "1->2         12   1.1",
        "2->1          9  2.25",
        "left out at 24 columns: mean age [s], p95 [s] (see result.json)",
    ]
    kept = [[column.heading.split("\n")[0] for column in fitting(COLUMNS, most)] for most in (36, 35, 29, 20, 3)]
    assert kept[0] == ["link", "delivered", "mean", "p95", "max"]
    assert kept[1] == ["link", "delivered", "mean", "max"]
    assert kept[2] == ["link", "delivered", "max"]
    assert kept[3] == kept[4] == ["link", "delivered"]


def test_brackets_are_no_markup() -> None:
    assert printed([TerminalColumn("[red]x", ["[/] y"])], 40) == ["[red]x", " [/] y"]


def test_no_terminal_obeys_what_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    foreign = "a\x1b]0;x\x07b\x9bc\r"
    say(f"{foreign}\n{foreign}")
    assert capsys.readouterr().out == "a�]0;x�b�c�\n" * 2
    shown = "\n".join(printed([TerminalColumn(foreign, [foreign])], 40))
    assert "a�]0;x�b�c�" in shown and "\x1b" not in shown


@given(st.integers(1, 60))
def test_what_is_kept_is_whole(most: int) -> None:
    kept = fitting(COLUMNS, most)
    if width(kept) <= most:
        lines = printed(kept, most)
        assert max(map(len, lines)) <= most
        text = "\n".join(lines)
        assert all(word in text for column in kept for word in (*column.heading.split("\n"), *column.cells))
    else:
        assert all(not column.rank for column in kept)


def test_columns_of_rows() -> None:
    found = columns({"a": 0, "b": 1}, [("1", "2"), ("3", "4")])
    assert found == [TerminalColumn("a", ("1", "3")), TerminalColumn("b", ("2", "4"), 1)]
    assert columns({"a": 0, "b": 1}, []) == [TerminalColumn("a", ()), TerminalColumn("b", (), 1)]


def test_a_table_hides_no_row_behind_one_row() -> None:
    assert [shown_rows(count, 4) for count in range(8)] == [0, 1, 2, 3, 4, 5, 4, 4]


def test_columns_that_must_be_there_are_whole_in_a_file() -> None:
    wide = [TerminalColumn("x" * 90, ["1"]), TerminalColumn("y" * 90, ["2"])]
    assert printed(wide, 120) == ["x" * 90 + "  " + "y" * 90, " " * 89 + "1" + " " * 91 + "2"]
