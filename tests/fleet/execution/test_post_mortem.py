"""Words on how a run ended."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fleet.execution.post_mortem import explain
from fleet.processes.children import Child, Exit


def test_of_many_that_ended_few_are_named(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    log.write_text("no answer\n")
    children: dict[str, Any] = {
        f"agent-{i}": Child(f"agent-{i}", SimpleNamespace(pid=i), log)  # type: ignore[arg-type]
        for i in range(1, 1001)
    }
    exits = [Exit(role, 1, child.pid) for role, child in children.items()]
    error = explain(exits, children, [], "t = 0.00 s (tick 0)")
    (others,) = [line for line in error.lines if line.startswith("also ended")]
    assert others.endswith(" and 991 more")
    assert others.count("exited with status 1") == 8
