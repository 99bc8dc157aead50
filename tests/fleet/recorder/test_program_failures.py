"""A program that failed is told with the line that has the reason, or else with its last one."""

from __future__ import annotations

import pytest

from fleet.recorder.program_failures import ProgramFailures
from netem.wire.messages import END, ERR, FAILED, Frame, Said, SaidBy

NODE = ["Uncaught ReferenceError: foo is not defined", "    at main (b.js:1:1)", "", "Node.js v20.20.2"]
PYTHON = ["Traceback (most recent call last):", '  File "x.py", line 1', "ValueError: planned"]


def failed(printed: list[str]) -> ProgramFailures:
    found = ProgramFailures()
    lines = [SaidBy(1, Said(k, ERR, text)) for k, text in enumerate(printed)]
    found.frame(Frame(1, False, (), (), (), (*lines, SaidBy(1, Said(99, FAILED, "exit status 1")))))
    return found


@pytest.mark.parametrize(
    ("printed", "last"),
    [
        (NODE, NODE[0]),
        (PYTHON, PYTHON[-1]),
        (["java.lang.IllegalStateException: no", "\tat Main.main(Main.java:3)"], "java.lang.IllegalStateException: no"),
        (["cannot open the port"], "cannot open the port"),
        (["ValueError: first", "KeyError: second", "bye"], "KeyError: second"),
        ([], ""),
    ],
)
def test_the_last_line_that_says_why_is_told(printed: list[str], last: str) -> None:
    """A trace of node.js was told by its last line, which is the version of node."""
    (one,) = failed(printed).first
    assert one.last == last


def test_any_line_counts_as_said_and_an_end_does_not() -> None:
    found = ProgramFailures()
    found.frame(Frame(1, False, (), (), (), (SaidBy(1, Said(5, END, "exit status 0")),)))
    assert not found.spoke
    assert failed(["x"]).spoke
