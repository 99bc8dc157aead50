"""Packages are rooms: each says in one sentence what it holds, modules are short, and no two import each other."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from repository import MODULES, PACKAGES, ROOT, tree

grimp = pytest.importorskip("grimp", reason="import-linter is not installed: '.[test-all]'")

LIMIT = 600  # lines

# Longer ones, each with its reason.
LONGER: dict[str, str] = {}


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_a_room_says_what_it_holds_in_one_sentence() -> None:
    """And imports nothing: `fleet --help` and the fork server pay for every line here."""
    for path in (path for path in MODULES if path.name == "__init__.py"):
        sentence = ast.get_docstring(tree(path)) or ""
        assert sentence.endswith(".") and sentence.count(". ") == sentence.count("\n") == 0, (path, sentence)
        if name_of(path) != "fleet/__init__.py":  # which gives `Log` and `open_log`, when they are asked for
            assert len(tree(path).body) == 1, f"{path}: only the sentence"


def test_modules_are_short() -> None:
    """One that is longer holds two concepts, or has its reason above."""
    lengths = {name_of(path): len(path.read_text("utf-8").splitlines()) for path in MODULES}
    longer = {name: length for name, length in lengths.items() if length >= LIMIT}
    assert sorted(longer) == sorted(LONGER), longer


def test_no_modules_import_each_other() -> None:
    """Nor in a circle of several: each can be read, tested and imported alone."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    roots = {module for module in graph.modules if graph.find_children(module)}
    left = {
        module: graph.find_modules_directly_imported_by(module) - roots - {module} for module in graph.modules - roots
    }
    while done := {module for module, imported in left.items() if not imported & left.keys()}:
        left = {module: imported for module, imported in left.items() if module not in done}
    while done := {module for module in left if not any(module in imported for imported in left.values())}:
        left = {module: imported for module, imported in left.items() if module not in done}
    assert not left, {module: sorted(imported & left.keys()) for module, imported in left.items()}
