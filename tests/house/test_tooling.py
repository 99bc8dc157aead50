"""The house rules are tests: the commands that the README gives, and pages that say what the code says."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from collections import Counter
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT
from stretches import dealt

from fleet.addons.hosts.protocol.page import page
from fleet.addons.hosts.protocol.scenario_slice import FIELDS
from netem.fault_kinds import WorldFaultKind


def commands(text: str) -> list[str]:
    """The lines of a text that set up the virtual environment and do something with it."""
    return re.findall(r"^(python3 -m venv .*)$", text, re.MULTILINE)


def test_ci_runs_the_readme_test_command() -> None:
    run, tests = commands((ROOT / "README.md").read_text("utf-8"))
    assert run.endswith("fleet run paper")
    assert commands((ROOT / ".ci" / "run").read_text("utf-8")) == [tests]


@pytest.mark.once
def test_a_property_test_that_hangs_ends_with_its_time(tmp_path: Path) -> None:
    """Hypothesis takes an exception for a failing example and calls the test again, without a time limit."""
    hangs = tmp_path / "test_hangs.py"
    law = "@given(some.none())\ndef test(_):\n    while True: pass\n"
    hangs.write_text(f"from hypothesis import given, strategies as some\n{law}")
    command = [sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", "--timeout=1", hangs]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "Timeout" in done.stdout


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
    """[`Class.name`](../file): the file holds the name; and every gap has its paragraph."""
    page_text = (ROOT / "docs" / "background" / "paper.md").read_text("utf-8")
    links = re.findall(r"\[`([\w.]+)`\]\(((?:\.\./)+[^)#]+\.py)\)", page_text)
    assert len(links) > 25
    for text, path in links:
        source = (ROOT / "docs" / "background" / path).resolve().read_text("utf-8")
        assert re.search(rf"\b{re.escape(text.rsplit('.', 1)[-1])}\b", source), (text, path)
    assert re.findall(r"^\*\*G(\d+)\.", page_text, re.MULTILINE) == [str(n) for n in range(1, 33)]


@pytest.mark.parametrize("cls", FIELDS)
def test_the_protocol_page_knows_every_field_of_a_slice(cls: type) -> None:
    """And calls them by the keys under which they travel, in their order."""
    assert list(FIELDS[cls]) == [field.name for field in fields(cls)]


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


def test_the_page_of_the_python_api_is_current() -> None:
    """python docs/python_api.py > docs/reference/api.md"""
    made = runpy.run_path(str(ROOT / "docs" / "python_api.py"))["page"]()
    assert (ROOT / "docs" / "reference" / "api.md").read_text("utf-8") == made


def test_what_takes_longer_begins_first_on_all_workers() -> None:
    """In a stretch for each; what shares something stays together, and nothing is lost."""
    tests = ["a", "b", "C1", "c", "d", "C2", "D", "e", "E", "f", "F"]
    found = dealt(tests, lambda test: test[0] if test[0].isupper() else None, 3)
    assert found == ["C1", "C2", "F", "D", "a", "b", "c", "E", "d", "e", "f"]
    assert dealt(tests, lambda test: None, 3) == tests


@given(st.lists(st.tuples(st.integers(), st.none() | st.integers(0, 3))), st.integers(1, 5))
def test_every_test_is_dealt_once(tests: list[tuple[int, int | None]], workers: int) -> None:
    found = dealt(tests, lambda test: test[1], workers)
    assert Counter(found) == Counter(tests)
    assert [test for test in found if test[1] is None] == [test for test in tests if test[1] is None]
