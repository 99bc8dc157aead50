"""Sections of docstrings are in order: each entry of `Args:` and `Attributes:` has its place, and names what exists."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from inspect import cleandoc, isclass, isfunction, signature, unwrap
from types import FunctionType, ModuleType

import pytest
from repository import MODULES, ROOT, tree

_ENTRY = re.compile(r"    (\*{0,2}\w+(?:, \*{0,2}\w+)*): \S")
_REST = re.compile(r" {8}\S")


def entries(docstring: str) -> Iterator[str]:
    """The names in the sections, and each line that is neither an entry nor the rest of one."""
    for section in re.findall(r"^ *(?:Args|Attributes):\n((?:.*\S.*\n?)+)", docstring, re.MULTILINE):
        for number, line in enumerate(section.splitlines()):
            entry = _ENTRY.match(line)
            if entry is not None:
                yield from (name.lstrip("*") for name in entry[1].split(", "))
            elif number == 0 or _REST.match(line) is None:
                yield line


def names_of(node: ast.AST) -> set[str]:
    """Arguments of a function; of a class those of `__init__`, and its attributes."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        every = node.args
        some = [*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg]
        return {each.arg for each in some if each is not None}
    names = set[str]()
    for part in ast.iter_child_nodes(node):
        match part:
            case ast.AnnAssign(target=ast.Name(id=name)) | ast.FunctionDef(name=name):
                names.add(name)
        if isinstance(part, ast.FunctionDef) and part.name == "__init__":
            names |= names_of(part) | {each.attr for each in ast.walk(part) if isinstance(each, ast.Attribute)}
    return names


def wrong(module: ast.Module) -> list[str]:
    """`line name: entry` for each entry that is out of place or names nothing."""
    found = []
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            known = names_of(node)
            stray = [entry for entry in entries(ast.get_docstring(node) or "") if entry not in known]
            found += [f"{node.lineno} {node.name}: {entry.strip()}" for entry in stray]
    return found


def test_entries_name_arguments_and_have_their_place() -> None:
    found = [f"{path.relative_to(ROOT)}:{entry}" for path in MODULES for entry in wrong(tree(path))]
    assert found == []


@pytest.mark.parametrize(
    ("docstring", "expected"),
    [
        ("Do.\n\n    Args:\n        a: it.\n            More of it.\n        b: this.\n", []),
        ("Do.\n\n    Args:\n        a: it.\n            b: this.\n", []),  # cannot be told from more of a
        ("Do.\n\n    Args:\n        a: it.\n    b: this.\n", ["1 do: b: this."]),
        ("Do.\n\n    Args:\n            a: it.\n        b: this.\n", ["1 do: a: it."]),
        ("Do.\n\n    Args:\n        c: it.\n", ["1 do: c"]),
    ],
)
def test_a_stray_entry_is_found(docstring: str, expected: list[str]) -> None:
    assert wrong(ast.parse(f'def do(a, b):\n    """{docstring}    """\n')) == expected


INTERFACES = ("agents.api", "fleet", "fleet.checks.api", "world.api")


def functions_of(interface: ModuleType) -> Iterator[tuple[str, FunctionType]]:
    """The functions that an interface exports, and the methods of its classes that have a docstring."""
    for name in interface.__all__:
        exported = getattr(interface, name)
        members = {name: exported} if isfunction(exported) else {}
        if isclass(exported):
            public = ((key, each) for key, each in vars(exported).items() if key == "__init__" or key[0] != "_")
            members = {f"{name}.{key}": getattr(each, "fget", None) or unwrap(each) for key, each in public}
        made_elsewhere = ("Log.__init__",)
        members = {full: each for full, each in members.items() if full not in made_elsewhere}
        yield from ((full, each) for full, each in members.items() if isfunction(each) and each.__doc__)


def unsaid(interface: ModuleType) -> list[str]:
    """`function: argument` for each argument without an entry, and `function: Returns` if that section is missing."""
    found = []
    for full, function in functions_of(interface):
        text, asked = cleandoc(function.__doc__ or ""), signature(function)
        arguments = set(asked.parameters) - {"self", "cls", "unknown"}  # the last one takes what is refused
        found += [f"{full}: {name}" for name in sorted(arguments - set(entries(text)))]
        # A property, or a method that asks for nothing, says what it is in its sentence.
        if arguments and asked.return_annotation not in ("None", None) and "\nReturns:\n" not in text:
            found.append(f"{full}: Returns")
    return found


@pytest.mark.parametrize("interface", INTERFACES)
def test_interfaces_say_every_argument_and_result(interface: str) -> None:
    """Attributes have a comment at their field instead."""
    assert unsaid(import_module(interface)) == []


def test_an_argument_without_words_is_found() -> None:
    interface = ModuleType("interface")
    exec('def do(a: int) -> int:\n    """Do."""\n__all__ = ["do"]', vars(interface))
    assert unsaid(interface) == ["do: a", "do: Returns"]
