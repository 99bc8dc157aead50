"""Each package has one base of its errors."""

from __future__ import annotations

import ast
import builtins
from functools import cache

from repository import MODULES, tree


@cache
def bases() -> dict[str, str]:
    """Base of each exception class of the packages that is not private to its module, in order of module and line."""
    found: dict[str, str] = {}
    for path in (path for path in MODULES if "templates" not in path.parts):
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.ClassDef) and node.bases and isinstance(node.bases[0], ast.Name):
                found[node.name] = node.bases[0].id
    return {name: base for name, base in found.items() if is_exception(name, found) and not name.startswith("_")}


def is_exception(name: str, found: dict[str, str]) -> bool:
    while name in found:
        name = found[name]
    known = getattr(builtins, name, None)
    return isinstance(known, type) and issubclass(known, BaseException)


def test_every_package_has_one_base() -> None:
    """So `except FleetError` misses none; what must pass such a clause is named here, with its reason there."""
    found = bases()
    roots = {name for name, base in found.items() if base not in found}
    stand_ins = {"ZenohError", "RefusedImport", "BrokenBarrierError"}  # for errors that programs of others catch
    assert roots - stand_ins == {
        "NetemError",
        "WorldError",
        "AgentError",
        "FleetError",
        "OutputError",
        "HungUp",
        "OverBudgetError",
    }
