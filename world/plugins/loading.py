"""Plug-ins: found by import path or entry point, and checked before a run depends on them."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from world.errors import PluginError
from world.plugins.checks import article
from world.plugins.error_place import place_of, shown_path, words_of
from world.plugins.trust import ONLY_INSTALLED, Permission, permit, permit_file, permitted_file

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

LAWS = "uuv_fleet.controllers"
PLANTS = "uuv_fleet.plants"
CHECKS = "uuv_fleet.checks"
# The entry points of each kind of plug-in; those of laws share one group.
GROUPS = {**dict.fromkeys(("controller", "guidance", "tracking", "agent"), LAWS), "plant": PLANTS, "check": CHECKS}
# What begins the name of a plug-in that is a file, and the entry points that make its class.
_FILES = {"plant": ("fmu:", "uuv_fleet.plant_files"), "agent": ("program:", "uuv_fleet.agent_files")}
_MAX_CLASSES = 8  # named in a hint


def unit_file(kind: str, name: str) -> str:
    """The file of a plug-in that is one, as a plant that is an FMU; "": the name is that of a class."""
    begin = _FILES[kind][0] if kind in _FILES else ""
    return name.removeprefix(begin) if begin and name.startswith(begin) else ""


def file_class(kind: str, name: str, parameters: Mapping[str, Any]) -> Any:
    """The class that is made of a file which may run.

    Args:
        kind: plant or agent.
        name: the file behind its first word, as in `fmu:FILE`.
        parameters: those that the scenario gives it.

    Raises:
        UntrustedError: the file may not run.
        PluginError: nothing here reads such a file, or it cannot be used.
    """
    word, group = name.partition(":")[0], _FILES[kind][1]
    maker = entry_points_of(group).get(word)
    if maker is None:
        raise PluginError(kind, name, "nothing here reads such a file", f"{word} is an entry point of group {group}")
    try:
        make = maker.load()
    except ImportError as error:
        raise PluginError(kind, name, f"what reads such a file does not load: {error}") from error
    return make(permitted_file(kind, name), parameters)


def load_class(kind: str, name: str, check: Callable[[Any], None]) -> type[Any]:
    """The class that a name stands for, checked.

    Args:
        kind: controller, plant, check, ...; see `GROUPS`.
        name: `package.module:Class`, or the name of an entry point in the kind's group.
        check: raises PluginError if the class cannot be used.

    Raises:
        UntrustedError: its module is not installed, and was not let in with `admit`.
        PluginError: there is no such class, or it cannot be used.
    """
    admit(kind, name)
    if ":" in name:
        plugin_class = _import(kind, name)
        check(plugin_class)
        return plugin_class  # type: ignore[no-any-return]
    value, plugin_class = _entry_point(kind, name)
    try:
        check(plugin_class)
    except PluginError as error:
        # By the words "does not load" fleet.scenario.rules knows that there is one.
        text = f"its entry point {value} does not load as {article(kind)} {kind}: {error.problem}"
        raise PluginError(kind, name, text, error.hint) from None
    return plugin_class  # type: ignore[no-any-return]


def admit(kind: str, name: str, permission: Permission = ONLY_INSTALLED) -> None:
    """Let the module of a plug-in be imported if it may run; see `world.plugins.trust.permit`.

    Args:
        kind: controller, plant, check, ...; see `GROUPS`.
        name: of the plug-in: `package.module:Class`, the name of an entry point, or `fmu:FILE` of a plant.
        permission: what may run besides what is installed.

    Raises:
        UntrustedError: it may not.
        PluginError: the name is none of a plug-in.
    """
    if unit_file(kind, name):
        permit_file(kind, name, unit_file(kind, name), permission)
    elif ":" in name:
        permit(kind, name, _module_name(kind, name), permission)
    elif (point := entry_points_of(GROUPS[kind]).get(name)) is not None:
        permit(kind, name, point.value.partition(":")[0].strip(), permission)


def fingerprint(plugin_class: type[Any]) -> str:
    """SHA-256 of the file that a plug-in is written in, to find out later whether it is still the same."""
    try:
        path = getattr(plugin_class, "plugin_file", None) or inspect.getsourcefile(plugin_class)
        return hashlib.sha256(Path(path or "").read_bytes()).hexdigest()
    except (OSError, TypeError):
        return "unknown"


def _module_name(kind: str, name: str) -> str:
    module_name, _, class_name = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), class_name)):
        raise PluginError(kind, name, "expected package.module:Class")
    if not name.isascii():  # a message in the log gets the name of the class
        raise PluginError(kind, name, "expected package.module:Class", "in a-z, A-Z, digits and _")
    return module_name


def _import(kind: str, name: str) -> Any:
    module_name, _, class_name = name.partition(":")
    importlib.invalidate_caches()
    try:
        module = _load(lambda: importlib.import_module(module_name))
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(error.name + ".")):
            hint = "it must be installed, or lie beside the scenario or where you are"
            raise PluginError(kind, name, f"there is no module {error.name!r}", hint) from None
        raise PluginError(kind, name, f"importing it failed: {error}", place_of(error)) from error
    except _LoadError as error:
        raise PluginError(kind, name, f"importing it failed: {error}", error.where) from error.__cause__
    if not hasattr(module, class_name):
        classes = [n for n, v in vars(module).items() if inspect.isclass(v) and v.__module__ == module.__name__]
        more = ", ..." if len(classes) > _MAX_CLASSES else ""
        listed = f"it has {', '.join(classes[:_MAX_CLASSES])}{more}" if classes else "it has no class at all"
        file = getattr(module, "__file__", None)
        hint = f"{listed} ({shown_path(file)})" if file else listed
        if (top := module_name.partition(".")[0]) in sys.stdlib_module_names:
            hint = f"Python's own module of that name hides yours: call your file my_{top}.py, for example"
            hint += f" ({shown_path(file)})" if file else ""
        raise PluginError(kind, name, f"module {module_name!r} has no {class_name!r}", hint)
    return getattr(module, class_name)


class _LoadError(Exception):
    """A module of the user's failed while it was imported; `where` is the line."""

    def __init__(self, text: str, where: str) -> None:
        super().__init__(text)
        self.where = where


def _load(load_it: Callable[[], Any]) -> Any:
    """The result of an import. Standard output is data, so prints of the module go to standard error."""
    try:
        with redirect_stdout(sys.stderr):
            return load_it()
    except (ModuleNotFoundError, KeyboardInterrupt):
        raise
    except BaseException as error:  # SystemExit, too: a module that ends the program is no plug-in
        where = place_of(error)
        if isinstance(error, SyntaxError) and error.filename:
            where = f"{shown_path(error.filename)}:{error.lineno}"
        raise _LoadError(words_of(error), where) from error


@cache
def entry_points_of(group: str) -> dict[str, EntryPoint]:
    """The entry points of a group by name, read once: reading them opens a file of every installed package."""
    from importlib.metadata import entry_points  # half of email comes with it

    return {point.name: point for point in entry_points(group=group)}


def _entry_point(kind: str, name: str) -> tuple[str, Any]:
    """`module:Class` as the entry point has it, and what it loads."""
    group = GROUPS[kind]
    points = entry_points_of(group)
    if name not in points:
        there = f"installed: {', '.join(sorted(points))}" if points else f"nothing is installed in group {group}"
        raise PluginError(
            kind, name, "there is none of this name", f"write package.module:Class, or install one; {there}"
        )
    value = points[name].value
    try:
        return value, _load(points[name].load)
    except ModuleNotFoundError as error:
        raise PluginError(kind, name, f"its entry point {value} does not load: {error}", place_of(error)) from error
    except _LoadError as error:
        raise PluginError(kind, name, f"its entry point {value} does not load: {error}", error.where) from error
