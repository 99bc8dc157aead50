"""Laws from elsewhere: found by import path or entry point, and checked before a run depends on them."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import sys
import traceback
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from agents.config import Law
from agents.errors import PluginError
from agents.signals import Signal

GROUP = "uuv_fleet.controllers"

# What a class of each kind must be able to do.
METHODS = {
    "controller": ("step",),
    "guidance": ("step",),
    "tracking": ("step",),
    "agent": ("transmit", "decide"),
}
_UNITLESS = "1"


def load(kind: str, law: Law) -> type[Any]:
    """The class of a law that is not ours, checked.

    Args:
        kind: controller, guidance, tracking or agent.
        law: `package.module:Class`, or the name of an entry point in group `uuv_fleet.controllers`.

    Raises:
        PluginError: there is no such class, or it cannot be used.
    """
    found = _import(kind, law.name) if ":" in law.name else _entry_point(kind, law.name)
    _check(kind, law, found)
    return found  # type: ignore[no-any-return]


def fingerprint(found: type[Any]) -> str:
    """SHA-256 of the file that a law's class is written in, to tell later whether it is still the same."""
    try:
        path = inspect.getsourcefile(found)
        return hashlib.sha256(Path(path or "").read_bytes()).hexdigest()
    except (OSError, TypeError):
        return "unknown"


def resumable(found: type[Any]) -> bool:
    """Whether a law can give and take back its state."""
    return callable(getattr(found, "state", None)) and callable(getattr(found, "restore", None))


def place_of(error: BaseException) -> str:
    """`file.py:12`: the innermost line of an error outside this package and the standard library's helpers."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _ours(f.filename)]
    if not frames:
        return ""
    return place_of_line(frames[-1].filename, frames[-1].lineno)


def place_of_line(filename: str, line: int | None) -> str:
    """`file.py:12`, relative to the current directory where it lies below it."""
    return f"{_shown(filename)}:{line}"


def place_of_method(method: Any) -> str:
    """`file.py:12`: where a method begins."""
    code = getattr(method, "__code__", None)
    return "" if code is None else place_of_line(code.co_filename, code.co_firstlineno)


def _ours(filename: str) -> bool:
    return Path(filename).parent == Path(__file__).parent or filename == "<frozen importlib._bootstrap>"


def _shown(filename: str) -> str:
    relative = os.path.relpath(filename)
    return filename if relative.startswith("..") else relative


def _import(kind: str, name: str) -> Any:
    module_name, _, class_name = name.partition(":")
    if not all(part.isidentifier() for part in module_name.split(".")) or not class_name.isidentifier():
        raise PluginError(kind, name, "expected package.module:Class")
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(error.name + ".")):
            looked = ", ".join(_shown(p) if p else "." for p in sys.path[-2:])
            hint = f"it must be installed, or lie beside the scenario or where you are (last searched: {looked})"
            raise PluginError(kind, name, f"there is no module {error.name!r}", hint) from None
        raise PluginError(kind, name, f"importing it failed: {error}", place_of(error)) from error
    except Exception as error:
        where = place_of(error)
        if isinstance(error, SyntaxError) and error.filename:
            where = f"{_shown(error.filename)}:{error.lineno}"
        raise PluginError(kind, name, f"importing it failed: {type(error).__name__}: {error}", where) from error
    if not hasattr(module, class_name):
        classes = [n for n, v in vars(module).items() if inspect.isclass(v) and v.__module__ == module.__name__]
        hint = f"it has {', '.join(classes)}" if classes else "it has no class at all"
        raise PluginError(kind, name, f"module {module_name!r} has no {class_name!r}", hint)
    return getattr(module, class_name)


def _entry_point(kind: str, name: str) -> Any:
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name not in points:
        there = f"installed: {', '.join(sorted(points))}" if points else f"nothing is installed in group {GROUP}"
        raise PluginError(
            kind, name, "there is none of this name", f"write package.module:Class, or install one; {there}"
        )
    try:
        return points[name].load()
    except Exception as error:
        text = f"its entry point {points[name].value} does not load: {type(error).__name__}: {error}"
        raise PluginError(kind, name, text, place_of(error)) from error


def _check(kind: str, law: Law, found: Any) -> None:
    name = law.name
    if not inspect.isclass(found):
        raise PluginError(kind, name, f"expected a class, got {type(found).__name__}")
    for method in METHODS[kind]:
        if not callable(getattr(found, method, None)):
            raise PluginError(kind, name, f"it has no method {method}", f"a {kind} needs {' and '.join(METHODS[kind])}")
    if callable(getattr(found, "state", None)) != callable(getattr(found, "restore", None)):
        raise PluginError(kind, name, "it has only one of state and restore", "write both, or neither")
    signals = getattr(found, "signals", None)
    if not isinstance(signals, tuple) or not all(isinstance(signal, Signal) for signal in signals):
        raise PluginError(
            kind, name, f"expected signals as a tuple of agents.api.Signal, got {signals!r:.80}", "() reports nothing"
        )
    seen: set[str] = set()
    for signal in signals:
        if not isinstance(signal.name, str) or not signal.name.isidentifier() or signal.name in seen:
            text = f"signal {signal.name!r} is not a name, or is declared twice"
            raise PluginError(kind, name, text, "names are letters, digits and _")
        if not isinstance(signal.unit, str) or not signal.unit:
            hint = f'write "{_UNITLESS}" for a number without'
            raise PluginError(kind, name, f"signal {signal.name!r} has no unit", hint)
        if not isinstance(signal.width, int) or not 1 <= signal.width <= 1000:
            raise PluginError(kind, name, f"signal {signal.name!r} has width {signal.width!r}", "1 to 1000")
        seen.add(signal.name)
    try:
        inspect.signature(found).bind(None, **law.parameters)
    except TypeError as error:
        shown = _parameters(found)
        hint = f"its parameters: {shown}" if shown else "it takes no parameters"
        raise PluginError(kind, name, f"cannot be made with these parameters: {error}", hint) from None


def _parameters(found: type[Any]) -> str:
    parameters = list(inspect.signature(found).parameters.values())[1:]
    return ", ".join(str(parameter) for parameter in parameters)
