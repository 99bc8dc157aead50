"""What command lines name is there, or it is told before the run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fleet.analysis.command_lines import warnings
from fleet.scenario.loading import parse_scenario
from fleet.scenario.trust import Policy


def told(folder: Path, **programs: Any) -> list[str]:
    sections = {"title": "x", "nodes": {"m1": {}, "m2": {}}, "duration": "1 s", "programs": programs}
    return [*warnings(parse_scenario(json.dumps(sections), "s.yaml", folder=folder, policy=Policy(stranger="")))]


@pytest.mark.parametrize(
    ("run", "expected"),
    [
        ("python3 missing.py x", "there is no file missing.py in {folder}"),
        ("python contr.py", 'there is no file contr.py in {folder}; did you mean "control.py"?'),
        ("/usr/bin/env-of-nobody x", "there is no file /usr/bin/env-of-nobody in {folder}"),
        ("./start.sh", "there is no file ./start.sh in {folder}"),
        ("sh run.sh", "there is no file run.sh in {folder}"),
        ("no-such-program-of-ours", "there is no program no-such-program-of-ours on the path"),
    ],
)
def test_a_file_or_a_program_that_is_not_there_is_told(run: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "control.py").touch()
    assert told(tmp_path, **{"m*": {"run": run}}) == [f"m1, m2: {expected.format(folder=tmp_path)}"]


@pytest.mark.parametrize(
    "run",
    [
        "python control.py", "python3 sub/own.py", "python -m http.server", "python -c pass", "python", "sh -c x",
        "python {dir}/own.py", "{dir}/start", "./control.py", "cat missing.txt", "/bin/sh control.py",
    ],
)  # fmt: skip
def test_what_is_there_or_known_at_the_start_only_is_not_told(run: str, tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    for name in ("control.py", "sub/own.py"):
        (tmp_path / name).touch()
    assert told(tmp_path, m1={"run": run}) == []


def test_a_script_is_looked_for_where_its_program_runs(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "own.py").touch()
    (tmp_path / "sub" / "tool").touch(0o755)
    assert told(tmp_path, m1={"run": "python own.py", "in": "sub"}) == []
    assert told(tmp_path, m1={"run": "python own.py"}) == [f"m1: there is no file own.py in {tmp_path}"]
    assert told(tmp_path, m1={"run": "tool", "env": {"PATH": str(tmp_path / "sub")}}) == []
