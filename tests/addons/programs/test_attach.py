"""Somebody sits at a program of a run: the terminal is the program's, and the sea waits."""

from __future__ import annotations

import os
import pty
import shutil
import sys
from pathlib import Path
from textwrap import dedent

import pytest
from own_program import scenario
from tool import invoke

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="the library for programs is compiled by cc")
PROGRAM = """
    import sys, time
    for n in range(4):
        time.sleep(0.5)
        if n == 1 and sys.argv[1] == "2": breakpoint()
        print("at", n, time.monotonic(), flush=True)
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "program.py").write_text(dedent(PROGRAM))
    (tmp_path / "own.yaml").write_text(scenario())


def at_terminal(attach: str, typed: list[tuple[str, str]]) -> tuple[str, int]:
    """Run with a terminal; returns what was printed there and the status. `typed`: after which text what is typed."""
    child, terminal = pty.fork()
    if not child:
        command = [sys.executable, "-m", "fleet", "run", "own.yaml", "--attach", attach]
        os.execve(sys.executable, command, os.environ | {"NO_COLOR": "1"})
    seen, looked = "", 0
    try:
        while data := os.read(terminal, 1 << 16):
            seen += data.decode(errors="replace")
            if typed and typed[0][0] in seen[looked:]:
                looked = len(seen)
                os.write(terminal, f"{typed.pop(0)[1]}\n".encode())
    except OSError:  # as the terminal says that nobody has it any more
        pass
    return seen, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_breakpoint_works_and_time_stands_still() -> None:
    said, status = at_terminal(
        "2", [("(Pdb) ", "print('now', time.monotonic())"), ("(Pdb) ", "print('n', n)"), ("(Pdb) ", "c")]
    )
    assert "now 1001.0" in said and "n 1" in said and "at 1 1001.0" in said and "at 3 1002.0" in said, said
    assert status == 0


@pytest.mark.skipif(shutil.which("gdb") is None, reason="gdb is not installed")
def test_a_debugger_comes_at_a_time() -> None:
    said, status = at_terminal(
        "1:gdb@1.2s", [("(gdb) ", "info inferiors"), ("(gdb) ", "continue"), ("exited normally", "quit")]
    )
    assert "gdb has the program" in said and "exited normally" in said, said
    assert status == 1  # the other program has no terminal for its breakpoint()


@pytest.mark.parametrize(
    ("asked", "words"),
    [("7", "agents are 1 to 2, got 7"), ("two", "expected an agent, such as 3"), ("1@2s", "expected an agent"),
     ("1", "needs a terminal")],
)  # fmt: skip
def test_what_cannot_be_attached_is_told(asked: str, words: str) -> None:
    refused = invoke("run", "own.yaml", "--attach", asked)
    assert refused.exit_code == 2 and words in refused.stderr, refused.output
