"""Mistakes on the command line: the status and words of each, as `tests/expected/messages-cli.txt` says.

Each entry there is a command as it is typed in a folder with three scenarios, two Python files, a log and files
that are no logs. All that a command is wrong about is found before it does anything: the folder stays as it is.
"""

from __future__ import annotations

import shlex
from contextlib import nullcontext
from pathlib import Path

import pytest
from in_process_runs import Alone, log_of
from refusals import check_refusals, type_command
from small_scenario import SMALL
from study_engine import Here

RANDOM = """\
nemesis: {every: 400 ms, for: 300 ms, pick: [mute, deaf]}
checks: {formation_error: {below: 4.6 m, after: 800 ms}, tumbled: waived}
"""
FILES = {
    "small.yaml": SMALL.encode(),
    "random.yaml": (SMALL + RANDOM).encode(),
    "ring.yaml": b"title: a ring\n",
    "ring.py": b"x = 1\n",
    "rung.py": b"x = 1\n",
    "empty.mcap": b"",
    "text.mcap": b"no log at all",
    "begun.mcap": b"\x89MCAP0\r\n",
    "torn.mcap": b"\x89MCAP0\r\n\x06" + b"\xff" * 8,
}
LONG = "x" * 300  # longer than any file system takes


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize("section", ["commands", pytest.param("page", marks=pytest.mark.extra)])
def test_a_mistake_is_told_with_its_remedy_and_changes_nothing(
    section: str, alone: Alone, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if section == "page":
        for package in ("nicegui", "foxglove"):
            pytest.importorskip(package, reason="an extra is not installed: '.[test-all]'")
    monkeypatch.setattr("fleet.addons.studies.engine.engine_of", lambda *_, **__: nullcontext(Here()))
    monkeypatch.chdir(tmp_path)
    there = FILES | {"run.mcap": log_of(alone("paper", "duration=2 s", "checks={}")).read_bytes()}
    for name, data in there.items():
        Path(name).write_bytes(data)

    def typed(line: str) -> None:
        try:
            type_command(*shlex.split(line.replace("LONG", LONG)))
        finally:
            assert files(tmp_path) == there, line

    check_refusals(f"cli/{section}", typed, hide={str(tmp_path): "HERE", LONG: "LONG"})
