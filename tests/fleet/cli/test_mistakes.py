"""Mistakes on the command line: the status and words of each, as `tests/expected/messages-cli.txt` says.

Each entry there is a command as it is typed in a folder with three scenarios and two Python files. All that a command
is wrong about is found before it does anything: the folder stays as it is.
"""

from __future__ import annotations

import shlex
from contextlib import nullcontext
from pathlib import Path

import pytest
from refusals import check_refusals, type_command
from small_scenario import SMALL
from study_engine import Here

RANDOM = """\
nemesis: {every: 400 ms, for: 300 ms, pick: [mute, deaf]}
checks: {formation_error: {below: 4.6 m, after: 800 ms}, tumbled: waived}
"""
FILES = {
    "small.yaml": SMALL,
    "random.yaml": SMALL + RANDOM,
    "ring.yaml": "title: a ring\n",
    "ring.py": "x = 1\n",
    "rung.py": "x = 1\n",
}


def files(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text("utf-8") for path in folder.rglob("*")}


def test_a_mistake_is_told_with_its_remedy_and_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fleet.study.engine.engine_of", lambda *_, **__: nullcontext(Here()))
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_text(text, "utf-8")

    def typed(line: str) -> None:
        try:
            type_command(*shlex.split(line))
        finally:
            assert files(tmp_path) == FILES, line

    check_refusals("cli/commands", typed, hide={str(tmp_path): "HERE"})
