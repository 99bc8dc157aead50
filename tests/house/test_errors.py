"""The tree of errors that `fleet.errors` opens with is the one in the code."""

from __future__ import annotations

import ast
import builtins
from functools import cache

from repository import MODULES, tree

import fleet.errors


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


def drawing(found: dict[str, str]) -> list[str]:
    """One line per class, below its base and in the order of the alphabet."""

    def below(base: str, indent: str) -> list[str]:
        names = sorted(name for name, of in found.items() if of == base)
        lines: list[str] = []
        for name in names:
            last = name == names[-1]
            lines.append(f"{indent}{'└── ' if last else '├── '}{name}")
            lines += below(name, indent + ("    " if last else "│   "))
        return lines

    roots = sorted({base for base in found.values() if base not in found}, key=lambda root: (root != "Exception", root))
    return [line for root in roots for line in (root, *below(root, ""))]


def test_the_drawn_tree_of_errors_is_that_of_the_classes() -> None:
    drawn = (fleet.errors.__doc__ or "").split("```")[1].strip("\n").splitlines()
    assert drawn == drawing(bases()), "draw this in fleet/errors.py:\n" + "\n".join(drawing(bases()))


def test_every_package_has_one_base() -> None:
    """So `except FleetError` misses none; what must pass such a clause is named here, with its reason there."""
    found = bases()
    roots = {name for name, base in found.items() if base not in found}
    assert roots == {"NetemError", "WorldError", "AgentError", "FleetError", "OutputError", "HungUp"}
