"""The methods that a class needs to be a plug-in, and the values that it may report."""

from __future__ import annotations

import inspect
import os
import re
import sysconfig
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import world
from netem.parsing import nearest
from world.errors import PluginError
from world.signal import Signal

# --- places
# Which line of the user's an error is about, and its text: for messages about the user's code.


_MAX_TEXT = 300  # characters of the text of an error
_LIBRARIES = tuple({sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")})
_PACKAGES = {Path(world.__file__).parent.with_name(name) for name in ("world", "agents", "fleet")}
_SITE = "-packages" + os.sep  # site-packages, and Debian's dist-packages


def place_of(error: BaseException) -> str:
    """`file.py:12`: the innermost line of an error that the user can have written.

    A line of a library, the standard one or an installed one, is the answer only if there is no other: what raised
    inside numpy was called from somewhere.
    """
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _ours(f.filename)]
    own = [f for f in frames if not in_library(f.filename)]
    if not own:  # an installed plug-in: its file is the first that was called
        installed = [f for f in frames if _SITE in f.filename] or frames
        own = [f for f in frames if f.filename == installed[0].filename]
    return place_of_line(own[-1].filename, own[-1].lineno) if own else ""


def in_library(filename: str) -> bool:
    """Whether a file belongs to the standard library or to an installed package."""
    return filename.startswith(_LIBRARIES) or filename.startswith("<frozen")


def words_of(error: BaseException) -> str:
    """`ValueError: its text`, on one line of at most 300 characters."""
    try:
        # A SyntaxError's own text ends with its place, which messages have beside it.
        text = " ".join(((error.msg or "") if isinstance(error, SyntaxError) else str(error)).split())
    except Exception:  # its __str__ is the user's, too
        text = "(it cannot be printed)"
    text = text if len(text) <= _MAX_TEXT else text[:_MAX_TEXT] + "..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def article(kind: str) -> str:
    """`a` or `an`, for the name of a kind of plug-in."""
    return "an" if kind[0] in "aeiou" else "a"


def place_of_line(filename: str, line: int | None) -> str:
    """`file.py:12`, relative to the current directory where it lies below it."""
    return f"{shown_path(filename)}:{line}"


def place_of_method(method: Any) -> str:
    """`file.py:12`: where a method, or the making of a class, begins."""
    code = getattr(method.__init__ if inspect.isclass(method) else method, "__code__", None)
    return "" if code is None else place_of_line(code.co_filename, code.co_firstlineno)


def _ours(filename: str) -> bool:
    return bool(_PACKAGES.intersection(Path(filename).parents)) or filename.startswith("<frozen importlib")


def shown_path(filename: str) -> str:
    """A path as messages show it: relative to the current directory where it lies below it."""
    relative = os.path.relpath(filename)
    return filename if relative.startswith("..") else relative


MAX_NUMBERS = 1000  # of one signal
_UNITLESS = "1"


def check_class(
    kind: str,
    name: str,
    plugin_class: Any,
    methods: Mapping[str, tuple[str, ...]],
    parameters: Mapping[str, Any],
    config: str,
) -> None:
    """Check that a class can be used as a plug-in of its kind.

    Args:
        kind: controller, plant, check, ...
        name: of the plug-in, for the message.
        plugin_class: the class that the name stands for.
        methods: the methods that it needs, and the arguments of each.
        parameters: its parameters, in addition to its configuration.
        config: describes its configuration, for the message.

    Raises:
        PluginError: it cannot.
    """
    if not inspect.isclass(plugin_class):
        raise PluginError(kind, name, f"expected a class, got {type(plugin_class).__name__}")
    for method, arguments in methods.items():
        if not callable(getattr(plugin_class, method, None)):
            hint = f"{article(kind)} {kind} needs {' and '.join(methods)}"
            raise PluginError(kind, name, f"it has no method {method}", hint)
        _check_method(kind, name, plugin_class, method, arguments)
    if abstract := sorted(getattr(plugin_class, "__abstractmethods__", ())):
        raise PluginError(kind, name, f"it is abstract: it lacks {', '.join(abstract)}")
    try:
        signature = inspect.signature(plugin_class)
    except ValueError:  # written in C: making it will show
        return
    try:
        signature.bind(None, **parameters)
    except TypeError as error:
        if "too many positional" in str(error):
            hint = f"write def __init__(self, config, ...): config is {config}"
            raise PluginError(kind, name, "it is made with its configuration, and takes none", hint) from None
        own = list(signature.parameters.values())[1:]
        shown = ", ".join(str(parameter.replace(annotation=inspect.Parameter.empty)) for parameter in own)
        hint = f"its parameters: {shown}" if shown else "it takes no parameters"
        names = [parameter.name for parameter in own]
        near = [word for key in parameters if key not in names and (word := nearest(key, names))]
        hint = " ".join([*near, hint])
        raise PluginError(kind, name, f"cannot be made with these parameters: {error}", hint) from None


def _check_method(kind: str, name: str, plugin_class: type[Any], method: str, arguments: tuple[str, ...]) -> None:
    function = inspect.getattr_static(plugin_class, method)
    if not inspect.isfunction(function):  # decorated, or written in C: calling it will show
        return
    place = place_of_method(function)
    if inspect.iscoroutinefunction(function) or inspect.isgeneratorfunction(function):
        raise PluginError(kind, name, f"its {method} must return its answer, not await or yield", place)
    try:
        inspect.signature(function).bind(None, *arguments)
    except TypeError as error:
        text = f"its {method} cannot be called as {method}({', '.join(arguments)}): {error}"
        raise PluginError(kind, name, text, place) from None


def check_signals(kind: str, name: str, signals: Any, taken: frozenset[str] = frozenset()) -> None:
    """Check that the declared signals can be logged.

    Args:
        kind: of the plug-in, for the message.
        name: of the plug-in, for the message.
        signals: declared by the class.
        taken: names that others use on the same topic.

    Raises:
        PluginError: they cannot.
    """
    if not isinstance(signals, tuple) or not all(isinstance(signal, Signal) for signal in signals):
        raise PluginError(
            kind, name, f"expected signals as a tuple of Signal, got {signals!r:.80}", "() reports nothing"
        )
    seen: dict[str, str] = {}  # name in JSON -> name
    for signal in signals:
        # As in protobuf, whose names are ASCII and differ also as JSON writes them: a_b is aB there.
        if not isinstance(signal.name, str) or not signal.name.isascii() or not signal.name.isidentifier():
            raise PluginError(kind, name, f"signal {signal.name!r} is not a name", "names are a-z, A-Z, digits and _")
        if signal.name in taken:
            hint = f"these are: {', '.join(sorted(taken))}"
            raise PluginError(kind, name, f"signal {signal.name!r} is reported already by every agent", hint)
        in_json = re.sub(r"_+(.?)", lambda match: match[1].upper(), signal.name)
        if seen.get(in_json) == signal.name:
            raise PluginError(kind, name, f"signal {signal.name!r} is declared twice")
        if in_json in seen:
            text = f"signals {seen[in_json]!r} and {signal.name!r} are both {in_json!r} in JSON"
            raise PluginError(kind, name, text, "rename one")
        if not isinstance(signal.unit, str) or not signal.unit:
            hint = f'write "{_UNITLESS}" for a number without'
            raise PluginError(kind, name, f"signal {signal.name!r} has no unit", hint)
        if not isinstance(signal.meaning, str):
            raise PluginError(kind, name, f"signal {signal.name!r} has meaning {signal.meaning!r:.80}, not a text")
        if not isinstance(signal.width, int) or not 1 <= signal.width <= MAX_NUMBERS:
            raise PluginError(kind, name, f"signal {signal.name!r} has width {signal.width!r}", f"1 to {MAX_NUMBERS}")
        seen[in_json] = signal.name
