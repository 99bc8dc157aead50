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
from netem.fault_kinds import WorldFaultKind

CHECKS = {
    "ruff check": [sys.executable, "-m", "ruff", "check", "."],
    "ruff format": [sys.executable, "-m", "ruff", "format", "--check", "."],
    "mypy": [sys.executable, "-m", "mypy"],
    # import-linter has no `-m`; its console script stands beside the interpreter.
    "import-linter": [str(Path(sys.executable).with_name("lint-imports"))],
}


@pytest.mark.timeout(400)  # mypy without its cache, on a machine that is busy
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "mypy" else []) for name in CHECKS]
)
def test_tool_is_content(name: str) -> None:
    done = subprocess.run(CHECKS[name], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def commands(text: str) -> list[str]:
    """The lines of a text that set up the virtual environment and do something with it."""
    return re.findall(r"^(python3 -m venv .*)$", text, re.MULTILINE)


def test_ci_runs_the_readme_test_command_and_the_slow_tests() -> None:
    run, tests = commands((ROOT / "README.md").read_text("utf-8"))
    assert run.endswith("fleet run paper")
    assert commands((ROOT / ".ci" / "run").read_text("utf-8")) == [f"{tests} -m ''"]


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


def test_the_protocol_page_defines_every_type_that_it_names() -> None:
    """Who writes a decoder finds each type of a table as a heading, or among the basic types of the first section."""
    text = page()
    basic = {"uint", "bool", "str", "bin", "real", "map", "nil", "null"}
    assert all(f"`{name}" in text for name in basic - {"map", "nil", "null"})
    headings = set(re.findall(r"^###? `(\w+)`", text, re.MULTILINE))
    tables = re.findall(r"^\| (?:field|key) \| type .*\n\|[-|]+\n((?:\|.*\n)+)", text, re.MULTILINE)
    types = {row.split(" | ")[1] for table in tables for row in table.splitlines()}
    words = {word for cell in types for word in re.split(r"\[\S*\]|, | or ", cell) if word}
    assert {"Life", "Tumble", "Frame", "Fate", "Offset"} <= words
    assert words <= headings | basic
    named = set(re.findall(r"(\w+)\[(?:\*|n|\d)\]", text)) - {"x"}
    assert named <= headings | basic
    assert "world.faults" not in text


def test_the_protocol_page_knows_every_kind_of_fault() -> None:
    assert all(f"\n| {kind} |" in page() for kind in WorldFaultKind)


def test_protocol_page_is_current() -> None:
    """docs/reference/protocol.md is what `fleet protocol` prints now."""
    assert (ROOT / "docs" / "reference" / "protocol.md").read_text("utf-8") == page()
