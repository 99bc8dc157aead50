"""The house rules are tests: style, types, the import arrow, and the commands that the README gives."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from repository import ROOT

from fleet.protocol import slice_fields
from fleet.protocol.page import page

CHECKS = {
    "ruff check": [sys.executable, "-m", "ruff", "check", "."],
    "ruff format": [sys.executable, "-m", "ruff", "format", "--check", "."],
    "mypy": [sys.executable, "-m", "mypy"],
    # import-linter has no `-m`; its console script stands beside the interpreter.
    "import-linter": [str(Path(sys.executable).with_name("lint-imports"))],
}


@pytest.mark.parametrize("name", CHECKS)
def test_tool_is_content(name: str) -> None:
    done = subprocess.run(CHECKS[name], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def commands(text: str) -> list[str]:
    """The lines of a text that set up the virtual environment and do something with it."""
    return re.findall(r"^(python3 -m venv .*)$", text, re.MULTILINE)


def test_ci_runs_the_readme_test_command() -> None:
    run, tests = commands((ROOT / "README.md").read_text("utf-8"))
    assert run.endswith("fleet run paper")
    assert commands((ROOT / ".ci" / "run").read_text("utf-8")) == [tests]


def test_project_stands_alone() -> None:
    """Nothing names a folder of somebody's machine or a place beside the project."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    names = listed.stdout.splitlines() or [str(p.relative_to(ROOT)) for p in ROOT.rglob("*.py")]
    words = ("../sha" + "red", "/wo" + "rk/", ".libr" + "ary/")
    found = []
    for name in names:
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".yaml", ".txt", ".json"} and path.is_file():
            text = path.read_text("utf-8")
            found += [f"{name}: {word}" for word in words if word in text]
    assert not found


def test_paper_page_links_lead_to_what_they_name() -> None:
    """[`Class.name`](../file#L12): line 12 of the file holds the name; and every gap has its paragraph."""
    page_text = (ROOT / "docs" / "background" / "paper.md").read_text("utf-8")
    links = re.findall(r"\[`([^`]+)`\]\((\.\./[^)#]+)#L(\d+)\)", page_text)
    assert len(links) > 25
    wrong = []
    for text, path, number in links:
        name = text.rsplit(".", 1)[-1]
        lines = (ROOT / "docs" / "background" / path).resolve().read_text("utf-8").splitlines()
        if not re.search(rf"\b{re.escape(name)}\b", lines[int(number) - 1]):
            now = [n for n, line in enumerate(lines, start=1) if re.search(rf"\b{re.escape(name)}\b", line)]
            wrong.append(f"{text} is not on line {number} of {path}, but on {now[:5]}")
    assert not wrong
    assert re.findall(r"^\*\*G(\d+)\.", page_text, re.MULTILINE) == [str(n) for n in range(1, 32)]


@pytest.mark.parametrize("cls", slice_fields.FIELDS)
def test_the_protocol_page_knows_every_field_of_a_slice(cls: type) -> None:
    """And calls them by the keys under which they travel, in their order."""
    assert list(slice_fields.FIELDS[cls]) == [field.name for field in fields(cls)]


def test_protocol_page_is_current() -> None:
    """docs/reference/protocol.md is what `fleet protocol` prints now."""
    assert (ROOT / "docs" / "reference" / "protocol.md").read_text("utf-8") == page()
