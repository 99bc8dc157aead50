"""Where things are in this repository, and its modules as trees."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
SUPPORT = Path(__file__).parent
EXPECTED = ROOT / "tests" / "expected"
GOLDEN = ROOT / "tests" / "golden"
PACKAGES = ("netem", "world", "agents", "fleet")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


@cache
def tree(path: Path) -> ast.Module:
    """A module, parsed once for all tests of a process."""
    return ast.parse(path.read_text("utf-8"))
