"""Lines are folded on a terminal only, between words, and what continues is indented."""

from __future__ import annotations

import io
import os
import sys
from types import SimpleNamespace

import pytest

from fleet.terminal.width import TABLES, _width, fold, say, stdout

PATH = "/a/long/path/which-is/copied/from-the/screen/run.mcap"


@pytest.mark.parametrize(
    ("text", "width", "shown"),
    [
        ("one two three", None, "one two three"),
        ("one two three", 13, "one two three"),
        ("one two three", 9, "one two\n  three"),
        ("  key  one two three", 15, "  key  one two\n    three"),
        (f"see {PATH}", 20, f"see\n  {PATH}"),
        ("a\n\nb c", 3, "a\n\nb c"),
        ("", 20, ""),
    ],
)
def test_lines_are_folded_between_words(text: str, width: int | None, shown: str) -> None:
    assert fold(text, width) == shown


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_only_a_terminal_folds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "10")
    screen, file = Screen(), io.StringIO()
    for stream in (screen, file):
        monkeypatch.setattr("sys.stdout", stream)
        say("one two three")
    assert (screen.getvalue(), file.getvalue()) == ("one two\n  three\n", "one two three\n")
    monkeypatch.setattr("sys.stderr", Screen())
    say("one two three", err=True)
    assert sys.stderr.getvalue() == "one two\n  three\n"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("columns", "found", "width"),
    [("", 60, 60), ("x", 60, 60), ("40", 60, 40), ("0", 60, 60), ("", 0, 80), ("", OSError(), 80)],
)
def test_the_width_of_a_terminal(
    columns: str, found: int | OSError, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def size(_: int) -> os.terminal_size:
        if isinstance(found, OSError):
            raise found
        return os.terminal_size((found, 24))

    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setattr("fleet.terminal.width.os.get_terminal_size", size)
    stream = SimpleNamespace(fileno=lambda: 1)
    assert _width(stream) == width  # type: ignore[arg-type]


def test_tables_are_as_wide_as_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "70")
    monkeypatch.setattr("sys.stdout", io.StringIO())
    assert stdout().width == TABLES
    monkeypatch.setattr("sys.stdout", Screen())
    monkeypatch.setenv("TERM", "xterm")
    assert stdout().width == 70
