"""Where the module of a law or another plug-in lies, and whether it may run here.

To import a module is to run it. Scenarios, logs and runs of strangers name plug-ins, so a name alone runs nothing. A
module runs in three cases: it is installed, it lies in a folder that is the user's own, or the user allowed it. Nothing
is imported to find that out. A plug-in that is a file of native code obeys the same rules, and is never installed.
"""

from __future__ import annotations

import importlib.util
import os
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

from world.errors import PluginError, UntrustedError

_added: list[str] = []  # folders that are on `sys.path` for the sake of modules that were allowed
_allowed: set[str] = set()  # modules outside of what is installed that may run
_own: dict[str, None] = {}  # folders of the user from which a plug-in was let run, in order
_files: dict[str, Path] = {}  # plug-ins that are files and may run: by name, where they lie


def _print_nothing(text: str) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Trust:
    """The modules that the user allows in addition to installed ones and those in the user's own folders."""

    everything: bool = False
    fingerprints: frozenset[str] = frozenset()  # SHA-256 of files that the user let another process run, hexadecimal
    notify: Callable[[str], None] = _print_nothing  # called with what runs because of this, before it runs


NOTHING = Trust()
_held: ContextVar[Trust] = ContextVar("trust", default=NOTHING)  # the trust that holds for what is being done


@contextmanager
def trusting(trust: Trust | bool) -> Iterator[None]:
    """Let more plug-ins be loaded inside: those that are trusted. True: all of them. False: no more than outside."""
    if trust is False:
        yield
        return
    token = _held.set(Trust(everything=True) if trust is True else trust)
    try:
        yield
    finally:
        _held.reset(token)


@dataclass(frozen=True, slots=True)
class Permission:
    """The modules that the plug-ins of one scenario, log or run may import besides installed and trusted ones."""

    own: tuple[Path, ...] = ()  # folders of the user, whose modules run without a word
    elsewhere: tuple[Path, ...] = ()  # folders to look in besides, whose modules need the user's trust
    because: str = "nobody allowed it"  # why they need it, for the message


ONLY_INSTALLED = Permission()


@dataclass(frozen=True, slots=True)
class ModulePlace:
    """Where a module lies."""

    folder: str  # where the search for its first name found it
    files: tuple[str, ...]  # files that importing it runs: its own, and those of its packages
    installed: bool


def permit(kind: str, name: str, module: str, permission: Permission) -> None:
    """Let the module of a plug-in be found and imported, if it may run.

    A module that does not exist is left to the import. One of the same name that ran from the folder of another
    scenario is forgotten, with all that ran from there.

    Args:
        kind: of the plug-in, for the message.
        name: of the plug-in, for the message.
        module: the plug-in's module.
        permission: allows modules in addition to installed ones.

    Raises:
        UntrustedError: it may not run.
        PluginError: it is no module for a plug-in.
    """
    own, because = permission.own, permission.because
    if module in _allowed and not (own or permission.elsewhere):
        return
    place = find(module, [*own, *permission.elsewhere])
    if module in sys.modules and not _namesake(module, place):  # the module ran before
        if place is not None and not place.installed:
            _allow(module, place)
        return
    if module.partition(".")[0] in sys.stdlib_module_names or module.endswith("__main__"):
        raise PluginError(kind, name, f"{module} is a part of Python or a program, not a module with a plug-in")
    if place is None or place.installed:
        return
    if os.path.realpath(place.folder) in map(os.path.realpath, own):
        if not _open_to_all(place.folder):
            _own[place.folder] = None
            _allow(module, place)
            return
        because = f"everybody may write into {place.folder}"
    _need_trust(kind, name, place.files, place.folder, because)
    _allow(module, place)


def permit_file(kind: str, name: str, file: str, permission: Permission) -> None:
    """Allow a plug-in to run that is a file of native code, if the permission covers it.

    Args:
        kind: kind of the plug-in, for the message.
        name: name of the plug-in; `permitted_file` finds it by this name.
        file: its path, absolute or within one of the folders of the permission.
        permission: says which files of native code may run.

    Raises:
        UntrustedError: the permission does not cover the file.
        PluginError: there is no such file.
    """
    _files.pop(name, None)  # another scenario may give this name to another file
    folders = [*permission.own, *permission.elsewhere]
    path = next((path for folder in folders if (path := Path(folder, file).resolve()).is_file()), None)
    if path is None:
        raise PluginError(kind, name, f"there is no file {file}", "it must lie beside the scenario or where you are")
    because = permission.because
    # It is the user's if it was found from his folder, not if it lies somewhere below: there may be logs of strangers.
    own = [
        str(f.resolve()) for f in permission.own if Path(f, file).resolve() == path and path.is_relative_to(f.resolve())
    ]
    if own and (folder := next((f for f in (str(path), str(path.parent)) if _open_to_all(f)), "")):
        own, because = [], f"everybody may write into {folder}"
    _own.update(dict.fromkeys(own))
    if not own:
        _need_trust(kind, name, (str(path),), str(path.parent), because)
    _files[name] = _files[f"{name.partition(':')[0]}:{path}"] = path  # agents get the name with the whole path


def permit_command(name: str, command: str, folder: str, permission: Permission | None) -> None:
    """Allow a program to be started, if the user asked for it.

    Args:
        name: of the program, for the message.
        command: its command line, for the message.
        folder: where it runs, absolute.
        permission: says whose folders may run programs; None: the scenario is the user's own, which may run any.

    Raises:
        UntrustedError: nobody allowed it.
    """
    if permission is None or folder in map(os.path.realpath, permission.own):
        _own[folder] = None
        return
    trust = _held.get()
    if not trust.everything:
        problem = f"would run {command} in {folder}, and {permission.because}"
        raise UntrustedError("program", name, problem, "read it first; --trust runs it")
    trust.notify(f"program {name} runs {command} in {folder}, as --trust allows")


def permitted_file(kind: str, name: str) -> Path:
    """Where a plug-in lies that `permit_file` let run. Raises UntrustedError: none did."""
    if name not in _files:
        raise UntrustedError(kind, name, "nobody allowed it", "--trust runs it")
    return _files[name]


def allow_file(name: str, path: Path) -> None:
    """Let a plug-in run that another process has let run, which started this one."""
    _files[name] = path


def own_folders() -> list[str]:
    """The folders of the user from which plug-ins were let run in this process, absolute."""
    return [os.path.abspath(folder) for folder in _own]


def _need_trust(kind: str, name: str, files: tuple[str, ...], folder: str, because: str) -> None:
    """Raise UntrustedError unless the user trusts these files, which lie in a folder; say so if they do."""
    trust, shown = _held.get(), " and ".join(map(_show, files)) or _show(folder)
    if not (trust.everything or _is_known(files, trust.fingerprints)):
        problem = f"would run {shown}, which is not installed, and {because}"
        raise UntrustedError(kind, name, problem, "read it first; --trust runs it")
    trust.notify(f"{kind} {name} runs {shown}, as --trust allows")


def find(module: str, folders: Iterable[Path]) -> ModulePlace | None:
    """Where importing a module would find it if the folders stood at the end of the search path; None: nowhere.

    They stand before the folders that other scenarios added.
    """
    first, *rest = module.split(".")
    spec = _first(first)
    places = [_installed_spec(first)] if spec is not None else []
    if spec is None or _folder(spec) in _added:
        spec = next(filter(None, (PathFinder.find_spec(first, [os.path.abspath(folder)]) for folder in folders)), spec)
    if spec is None:
        return None
    specs, whole = [spec], first
    for part in rest:
        whole += f".{part}"
        below = PathFinder.find_spec(whole, list(specs[-1].submodule_search_locations or ()))
        if below is None:  # the import will fail
            break
        specs.append(below)
    files = tuple(s.origin for s in specs if s.origin is not None and s.has_location)
    return ModulePlace(_folder(spec), files, any(p is not None and _same(p, spec) for p in places))


def _first(name: str) -> ModuleSpec | None:
    """The module that `import name` would find."""
    try:
        return importlib.util.find_spec(name)
    except (ValueError, ImportError):  # the module is of unknown origin, as `__main__` is
        return None


def _installed_spec(name: str) -> ModuleSpec | None:
    """The module that `import name` would find without the current directory and without the folders added here."""
    for finder in list(sys.meta_path):
        spec = finder.find_spec(name, list(_environment()) if finder is PathFinder else None)
        if spec is not None:
            return spec
    return None


def _environment() -> Iterator[str]:
    # `python -m`, `python -c` and notebooks put the current directory first, unless they were told not to.
    first = 0 if sys.flags.safe_path or os.path.realpath(sys.path[0]) != os.path.realpath(".") else 1
    for entry in sys.path[first:]:
        if entry and entry not in _added:
            yield entry


def _same(one: ModuleSpec, other: ModuleSpec) -> bool:
    where = [(s.origin, list(s.submodule_search_locations or ())) for s in (one, other)]
    return where[0] == where[1]


def _folder(spec: ModuleSpec) -> str:
    """Where a module without a dot in its name lies."""
    inside = spec.submodule_search_locations
    return os.path.dirname(next(iter(inside)) if inside else spec.origin or "")


def _namesake(module: str, place: ModulePlace | None) -> str:
    """The folder of another scenario where `import` would find a module of the same name first; "": none."""
    spec = _first(module.partition(".")[0])
    ran = _folder(spec) if spec is not None else ""
    return ran if place is not None and ran in _added and ran != place.folder else ""


def _forget(folder: str) -> None:
    """Take a folder of another scenario off the search path, and all modules out that ran from there.

    The modules beside the one of the same name go as well, since it may have imported them under names that the new
    folder has, too. Objects of theirs live on; only `import` does not find them any more.
    """
    tops = {n for n, m in sys.modules.items() if (s := getattr(m, "__spec__", None)) and _folder(s) == folder}
    for name in [name for name in sys.modules if name.partition(".")[0] in tops]:
        del sys.modules[name]
        _allowed.discard(name)
    sys.path[:] = [entry for entry in sys.path if entry != folder]
    _added.remove(folder)


def _allow(module: str, place: ModulePlace) -> None:
    if other := _namesake(module, place):
        _forget(other)
    _allowed.add(module)
    if place.folder not in sys.path[1:]:
        # At the end, so that nothing there takes the place of an installed module; agents get this path, too.
        sys.path.append(place.folder)
        _added.append(place.folder)


def _open_to_all(folder: str) -> bool:
    try:
        return bool(os.stat(folder).st_mode & stat.S_IWOTH)
    except OSError:
        return True


def _is_known(files: tuple[str, ...], fingerprints: frozenset[str]) -> bool:
    import hashlib  # loads OpenSSL, which --help needs not

    try:
        return bool(files) and fingerprints.issuperset(
            hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in files
        )
    except OSError:
        return False


def _show(file: str) -> str:
    relative = os.path.relpath(file)
    return file if relative.startswith("..") else relative
