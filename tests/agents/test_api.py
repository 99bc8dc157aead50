"""`agents.api` is all that a law needs: what it exports is what the guide lists, and ours import nothing else."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from repository import ROOT

import agents.api
from agents.plugins.laws import METHODS

USERS = sorted([*(ROOT / "fleet/addons/templates").glob("*.py"), *(ROOT / "docs/examples").glob("*.py")])
OURS = ("agents", "netem", "world", "fleet")


def imports(path: Path) -> list[tuple[str, str]]:
    """(module, name) of everything that a file imports."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            found += [(node.module or "", alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
    return found


def test_all_is_every_public_name() -> None:
    """Names that the module defines, or takes from our other modules; what it takes from Python is not its own."""
    public = {name for module, name in imports(Path(agents.api.__file__)) if module.partition(".")[0] in OURS}
    for node in ast.parse(Path(agents.api.__file__).read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            public.add(node.name)
        elif isinstance(node, ast.Assign):
            public |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    assert list(agents.api.__all__) == sorted(name for name in public if name and not name.startswith("_"))


def test_the_reference_lists_all_of_it() -> None:
    page = (ROOT / "docs/reference/api.md").read_text("utf-8").partition("## Writing laws\n")[2]
    assert set(re.findall(r"^### `(\w+)`", page, re.MULTILINE)) >= set(agents.api.__all__)


@pytest.mark.parametrize("path", USERS, ids=lambda path: path.name)
def test_templates_and_examples_need_no_other_module_of_agents(path: Path) -> None:
    found = [(module, name) for module, name in imports(path) if module.partition(".")[0] == "agents"]
    assert [(module, name) for module, name in found if module != "agents.api" or name not in agents.api.__all__] == []


def test_the_protocols_have_the_methods_that_are_asked_for() -> None:
    protocols = {
        "controller": agents.api.Controller,
        "guidance": agents.api.Guidance,
        "tracking": agents.api.Tracking,
        "agent": agents.api.WholeAgent,
    }
    asked = {kind: set(methods) for kind, methods in METHODS.items()}
    assert {kind: set(METHODS[kind]) & set(vars(protocol)) for kind, protocol in protocols.items()} == asked
