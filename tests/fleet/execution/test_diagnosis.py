"""Words on how a run ended."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fleet.errors import RunBroken
from fleet.execution.diagnosis import explain
from fleet.execution.notes import fold_notes, text_without_agent
from fleet.processes.children import Child, Exit


def explained(log: Path, said: str, agents: int, code: int, notes: list[str]) -> RunBroken:
    """What is told of so many agents that ended with this code."""
    log.write_text(said)
    roles = {f"agent-{i}": i for i in range(1, agents + 1)}
    children: dict[str, Any] = {role: Child(role, SimpleNamespace(pid=i), log) for role, i in roles.items()}  # type: ignore[arg-type]
    return explain([Exit(role, code, i) for role, i in roles.items()], children, notes, "t = 0.00 s (tick 0)")


def test_of_many_that_ended_few_are_named(tmp_path: Path) -> None:
    error = explained(tmp_path / "a.log", "no answer\n", 1000, 1, [])
    (others,) = [line for line in error.lines if line.startswith("also ended")]
    assert others.endswith(" and 991 more")
    assert others.count("exited with status 1") == 8


def test_an_error_that_all_agents_report_is_told_once(tmp_path: Path) -> None:
    """What four agents raise when they are made is one line, and the traceback stays in its file."""
    log = tmp_path / "a.log"
    said = 'Traceback (most recent call last):\n  File "law.py", line 3, in __init__\nValueError: no good\n'
    notes = [f"t = 0.00 s (tick 0) agent {i}: failed: agent {i}, tick 0: no good (law.py:3)" for i in (2, 1, 4, 3)]
    notes.append("t = 0.00 s (tick 0) agent 4: something else")
    error = explained(log, said, 4, 70, notes)
    assert "\n".join(error.lines).count("no good") == 1
    assert error.lines[0] == f"{notes[1]} (so did agents 2, 3, 4)"
    assert error.lines[1] == f"the traceback is in {log}"
    assert text_without_agent(error.lines[0]) == text_without_agent(
        notes[0]
    )  # so that a table of notes leaves them out
    assert fold_notes(notes) == [f"{notes[0]} (so did agents 1, 3, 4)", notes[4]]
