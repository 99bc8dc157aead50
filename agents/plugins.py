"""Laws from elsewhere: found by import path or entry point, and checked before a run depends on them."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from agents.config import Law
from agents.errors import PluginError
from agents.signals import Signal
from agents.trust import NOTHING, Trust, permit

GROUP = "uuv_fleet.controllers"

# What a class of each kind must be able to do, and with what it is called.
METHODS: dict[str, dict[str, tuple[str, ...]]] = {
    "controller": {"step": ("sample",)},
    "guidance": {"step": ("sample",)},
    "tracking": {"step": ("sample", "command")},
    "agent": {"transmit": ("nav",), "decide": ("nav", "deliveries")},
}
MOST_NUMBERS = 1000  # of one signal
_UNITLESS = "1"
_MOST_CLASSES = 8  # named in a hint
_MOST_TEXT = 300  # characters of what an error of the user's says
_LIBRARIES = tuple({sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")})
_SITE = "-packages" + os.sep  # site-packages, and Debian's dist-packages


def load(kind: str, law: Law) -> type[Any]:
    """The class of a law that is not ours, checked.

    Args:
        kind: controller, guidance, tracking or agent.
        law: `package.module:Class`, or the name of an entry point in group `uuv_fleet.controllers`.

    Raises:
        UntrustedError: its module is not installed, and nobody has let it in with `admit`.
        PluginError: there is no such class, or it cannot be used.
    """
    admit(kind, law.name)
    if ":" in law.name:
        found = _import(kind, law.name)
        _check(kind, law, found)
        return found  # type: ignore[no-any-return]
    value, found = _entry_point(kind, law.name)
    try:
        _check(kind, law, found)
    except PluginError as error:
        # By the words "does not load" fleet.rules knows that there is one.
        text = f"its entry point {value} does not load as a law: {error.problem}"
        raise PluginError(kind, law.name, text, error.hint) from None
    return found  # type: ignore[no-any-return]


def admit(
    kind: str,
    name: str,
    trust: Trust = NOTHING,
    own: Iterable[Path] = (),
    elsewhere: Iterable[Path] = (),
    because: str = "nobody allowed it",
) -> None:
    """Let the module of a law be imported if it may run; see `agents.trust.permit`.

    Raises:
        UntrustedError: it may not.
        PluginError: the name is none of a law.
    """
    if ":" in name:
        permit(kind, name, _module_name(kind, name), trust, own, elsewhere, because)
    elif (point := _points().get(name)) is not None:
        permit(kind, name, point.value.partition(":")[0].strip(), trust, own, elsewhere, because)


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
    """`file.py:12`: the innermost line of an error that the user can have written.

    A line of a library, the standard one or an installed one, is the answer only if there is no other: what raised
    inside numpy was called from somewhere.
    """
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _ours(f.filename)]
    own = [f for f in frames if not in_library(f.filename)]
    if not own:  # an installed law: its file is the first that was called
        installed = [f for f in frames if _SITE in f.filename] or frames
        own = [f for f in frames if f.filename == installed[0].filename]
    return place_of_line(own[-1].filename, own[-1].lineno) if own else ""


def in_library(filename: str) -> bool:
    """Whether a file belongs to the standard library or to an installed package."""
    return filename.startswith(_LIBRARIES) or filename.startswith("<frozen")


def words_of(error: BaseException) -> str:
    """`ValueError: what it says`, on one line, and not too long a one."""
    try:
        # A SyntaxError's own text ends with its place, which is told beside it.
        text = " ".join(((error.msg or "") if isinstance(error, SyntaxError) else str(error)).split())
    except Exception:  # its __str__ is the user's, too
        text = "(it cannot be printed)"
    text = text if len(text) <= _MOST_TEXT else text[:_MOST_TEXT] + "..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def place_of_line(filename: str, line: int | None) -> str:
    """`file.py:12`, relative to the current directory where it lies below it."""
    return f"{_shown(filename)}:{line}"


def place_of_method(method: Any) -> str:
    """`file.py:12`: where a method, or the making of a class, begins."""
    code = getattr(method.__init__ if inspect.isclass(method) else method, "__code__", None)
    return "" if code is None else place_of_line(code.co_filename, code.co_firstlineno)


def _ours(filename: str) -> bool:
    return Path(filename).parent == Path(__file__).parent or filename.startswith("<frozen importlib")


def _shown(filename: str) -> str:
    relative = os.path.relpath(filename)
    return filename if relative.startswith("..") else relative


def _module_name(kind: str, name: str) -> str:
    module_name, _, class_name = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), class_name)):
        raise PluginError(kind, name, "expected package.module:Class")
    if not name.isascii():  # it also names the message in the log
        raise PluginError(kind, name, "expected package.module:Class", "in a-z, A-Z, digits and _")
    return module_name


def _import(kind: str, name: str) -> Any:
    module_name, _, class_name = name.partition(":")
    importlib.invalidate_caches()
    try:
        module = _loaded(lambda: importlib.import_module(module_name))
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(error.name + ".")):
            hint = "it must be installed, or lie beside the scenario or where you are"
            raise PluginError(kind, name, f"there is no module {error.name!r}", hint) from None
        raise PluginError(kind, name, f"importing it failed: {error}", place_of(error)) from error
    except _LoadError as error:
        raise PluginError(kind, name, f"importing it failed: {error}", error.where) from error.__cause__
    if not hasattr(module, class_name):
        classes = [n for n, v in vars(module).items() if inspect.isclass(v) and v.__module__ == module.__name__]
        more = ", ..." if len(classes) > _MOST_CLASSES else ""
        listed = f"it has {', '.join(classes[:_MOST_CLASSES])}{more}" if classes else "it has no class at all"
        file = getattr(module, "__file__", None)
        hint = f"{listed} ({_shown(file)})" if file else listed
        raise PluginError(kind, name, f"module {module_name!r} has no {class_name!r}", hint)
    return getattr(module, class_name)


class _LoadError(Exception):
    """A module of the user's failed while it was imported; `where` is the line."""

    def __init__(self, text: str, where: str) -> None:
        super().__init__(text)
        self.where = where


def _loaded(load_it: Callable[[], Any]) -> Any:
    """What an import returns. Standard output is data, so what the module prints goes to standard error."""
    try:
        with redirect_stdout(sys.stderr):
            return load_it()
    except (ModuleNotFoundError, KeyboardInterrupt):
        raise
    except BaseException as error:  # SystemExit, too: a module that ends the program is no law
        where = place_of(error)
        if isinstance(error, SyntaxError) and error.filename:
            where = f"{_shown(error.filename)}:{error.lineno}"
        raise _LoadError(words_of(error), where) from error


def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def _entry_point(kind: str, name: str) -> tuple[str, Any]:
    """What the entry point says, and what is there."""
    points = _points()
    if name not in points:
        there = f"installed: {', '.join(sorted(points))}" if points else f"nothing is installed in group {GROUP}"
        raise PluginError(
            kind, name, "there is none of this name", f"write package.module:Class, or install one; {there}"
        )
    value = points[name].value
    try:
        return value, _loaded(points[name].load)
    except ModuleNotFoundError as error:
        raise PluginError(kind, name, f"its entry point {value} does not load: {error}", place_of(error)) from error
    except _LoadError as error:
        raise PluginError(kind, name, f"its entry point {value} does not load: {error}", error.where) from error


def _check(kind: str, law: Law, found: Any) -> None:
    name = law.name
    if not inspect.isclass(found):
        raise PluginError(kind, name, f"expected a class, got {type(found).__name__}")
    for method, arguments in METHODS[kind].items():
        if not callable(getattr(found, method, None)):
            article = "an" if kind == "agent" else "a"
            hint = f"{article} {kind} needs {' and '.join(METHODS[kind])}"
            raise PluginError(kind, name, f"it has no method {method}", hint)
        _check_method(kind, name, found, method, arguments)
    if abstract := sorted(getattr(found, "__abstractmethods__", ())):
        raise PluginError(kind, name, f"it is abstract: it lacks {', '.join(abstract)}")
    if callable(getattr(found, "state", None)) != callable(getattr(found, "restore", None)):
        raise PluginError(kind, name, "it has only one of state and restore", "write both, or neither")
    _check_signals(kind, name, getattr(found, "signals", None))
    try:
        signature = inspect.signature(found)
    except ValueError:  # written in C: making it will tell
        return
    try:
        signature.bind(None, **law.parameters)
    except TypeError as error:
        if "too many positional" in str(error):
            hint = "write def __init__(self, config, ...): config is the agent's own slice of the scenario"
            raise PluginError(kind, name, "it is made with the agent's configuration, and takes none", hint) from None
        own = list(signature.parameters.values())[1:]
        shown = ", ".join(str(parameter.replace(annotation=inspect.Parameter.empty)) for parameter in own)
        hint = f"its parameters: {shown}" if shown else "it takes no parameters"
        raise PluginError(kind, name, f"cannot be made with these parameters: {error}", hint) from None


def _check_method(kind: str, name: str, found: type[Any], method: str, arguments: tuple[str, ...]) -> None:
    """A method that cannot be called, or does not answer at once, is found before the run."""
    function = inspect.getattr_static(found, method)
    if not inspect.isfunction(function):  # decorated, or written in C: calling it will tell
        return
    place = place_of_method(function)
    if inspect.iscoroutinefunction(function) or inspect.isgeneratorfunction(function):
        raise PluginError(kind, name, f"its {method} must return its answer, not await or yield", place)
    try:
        inspect.signature(function).bind(None, *arguments)
    except TypeError as error:
        text = f"its {method} cannot be called as {method}({', '.join(arguments)}): {error}"
        raise PluginError(kind, name, text, place) from None


def _check_signals(kind: str, name: str, signals: Any) -> None:
    """What is declared can be logged."""
    # Here, because agents.controllers is built on this module.
    from agents.controllers import COMMANDED, HEARD

    if not isinstance(signals, tuple) or not all(isinstance(signal, Signal) for signal in signals):
        raise PluginError(
            kind, name, f"expected signals as a tuple of agents.api.Signal, got {signals!r:.80}", "() reports nothing"
        )
    # A guidance law's signals share their topic with what every agent reports.
    taken = {signal.name for signal in (*HEARD, *COMMANDED)} if kind == "guidance" else set()
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
        if not isinstance(signal.width, int) or not 1 <= signal.width <= MOST_NUMBERS:
            raise PluginError(kind, name, f"signal {signal.name!r} has width {signal.width!r}", f"1 to {MOST_NUMBERS}")
        seen[in_json] = signal.name
