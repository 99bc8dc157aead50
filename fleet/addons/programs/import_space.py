"""What a program imports: stand-ins, modules of its own, and libraries that all programs share.

A program and all pure Python beside it or installed for it are loaded once more for each agent and each life, so no
state is shared. Packages with compiled parts, and the parts of Python that know neither time nor chance, are shared.
"""

from __future__ import annotations

import builtins
import importlib
import importlib.util
import sys
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

MakeModule = Callable[[], ModuleType]

# Parts of Python that a program gets once more, because they ask for what stand-ins give: time, threads, chance.
OWN_OF_PYTHON = frozenset(
    (
        *("_strptime", "argparse", "cmd", "concurrent", "dataclasses", "fileinput", "logging", "optparse", "pprint"),
        *("queue", "random", "sched", "secrets", "selectors", "traceback", "uuid"),
    )
)
# Parts in C that the Python of these modules does without, and must.
_WITHOUT = frozenset(("_queue", "_uuid"))


class RefusedImport(ImportError):
    """A module that a program in lockstep cannot have."""


@lru_cache(maxsize=16)
def _compiled(text: bytes, path: str) -> CodeType:
    code: CodeType = compile(text, path, "exec", dont_inherit=True)
    return code


class ImportSpace:
    """The modules of one program."""

    def __init__(
        self,
        folder: Path,
        stand_ins: Mapping[str, MakeModule],
        refused: Mapping[str, str],
        own_builtins: Mapping[str, Any],
        shared: Sequence[str] = (),
    ) -> None:
        """Prepare it; nothing is imported yet.

        Args:
            folder: where the program lies, the first place where modules are looked for.
            stand_ins: what makes the module of a name, by name.
            refused: why a module cannot be had, by its first name or its whole one.
            own_builtins: in place of Python's.
            shared: further packages that all programs share, by their first name.
        """
        self.modules: dict[str, ModuleType] = {}
        self.path = [str(folder), *sys.path[1:]]
        self.every_module = ChainMap(self.modules, sys.modules)
        self._stand_ins, self._refused, self._shared = stand_ins, refused, frozenset(shared)
        self.make_others: Callable[[str], ModuleType | None] = lambda _: None  # by the name of a module
        self._builtins = vars(builtins) | {"__import__": self._import} | dict(own_builtins)

    def run(self, file: Path, name: str = "__main__") -> ModuleType:
        """Run a file as a module. What it raises passes on."""
        loader = SourceFileLoader(name, str(file))
        module = self._new(ModuleSpec(name, loader, origin=str(file)), package="")
        # Compiled as Python does with the file that it is given: its cache would miss a change within a second.
        code = _compiled(loader.get_data(str(file)), str(file))
        exec(code, vars(module))  # the program's own code, which trust has let run
        return module

    def load(self, name: str) -> ModuleType:
        """The module of a whole name, and those above it. Raises ImportError."""
        if name in self.modules:
            return self.modules[name]
        above, _, last = name.rpartition(".")
        parent = self.load(above) if above else None
        if name in self.modules:  # the one above has imported it
            return self.modules[name]
        module = self._found(name, parent)
        self.modules[name] = module
        if parent is not None:
            setattr(parent, last, module)
        return module

    def _found(self, name: str, parent: ModuleType | None) -> ModuleType:
        first = name.partition(".")[0]
        if make := self._stand_ins.get(name):
            return make()
        if (made := self.make_others(name)) is not None:
            return made
        if why := self._refused.get(name) or self._refused.get(first):
            raise RefusedImport(f"{name}: {why}", name=name)
        if name in _WITHOUT:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        spec = self._spec(name, first, parent)
        if spec is None:
            return importlib.import_module(name)
        module = self._new(spec, spec.name if spec.submodule_search_locations is not None else name.rpartition(".")[0])
        self.modules[name] = module
        try:
            assert isinstance(spec.loader, SourceFileLoader)
            self._fill(module, spec.loader)
        except BaseException:
            self.modules.pop(name, None)
            raise
        return self.modules[name]

    def _spec(self, name: str, first: str, parent: ModuleType | None) -> ModuleSpec | None:
        """Where a module of the program's own lies; None: it is one that all share."""
        path = self.path if parent is None else getattr(parent, "__path__", None)
        spec = None if path is None else PathFinder.find_spec(name, list(path))
        if spec is None or not isinstance(spec.loader, SourceFileLoader):
            return None
        if first in sys.stdlib_module_names:
            return spec if first in OWN_OF_PYTHON else None
        return None if first in self._shared or _has_compiled_parts(first) else spec

    def _new(self, spec: ModuleSpec, package: str) -> ModuleType:
        module = ModuleType(spec.name)
        vars(module).update(
            __file__=spec.origin, __spec__=spec, __loader__=spec.loader, __package__=package,
            __builtins__=self._builtins,
        )  # fmt: skip
        if spec.submodule_search_locations is not None:
            module.__path__ = list(spec.submodule_search_locations)
        self.modules[spec.name] = module
        return module

    def _fill(self, module: ModuleType, loader: SourceFileLoader) -> None:
        code = loader.get_code(module.__name__)
        assert code is not None
        exec(code, vars(module))  # the program's own code, which trust has let run

    def _import(
        self, name: str, globals: Mapping[str, Any] | None = None, locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] | None = (), level: int = 0,
    ) -> ModuleType:  # fmt: skip
        if level:
            package = (globals or {}).get("__package__") or ""
            name = importlib.util.resolve_name("." * level + name, package)
        module = self.load(name)
        if not fromlist:
            return module if level else self.modules[name.partition(".")[0]]
        for each in fromlist:
            if each != "*" and not hasattr(module, each) and hasattr(module, "__path__"):
                try:
                    self.load(f"{name}.{each}")
                except ModuleNotFoundError as error:
                    if error.name != f"{name}.{each}":
                        raise
        return module


@cache
def _has_compiled_parts(first: str) -> bool:
    """Whether a package has modules in C: they cannot be loaded twice."""
    spec = importlib.util.find_spec(first)
    places = [] if spec is None or spec.submodule_search_locations is None else [*spec.submodule_search_locations]
    return any(file.name.endswith(tuple(EXTENSION_SUFFIXES)) for place in places for file in Path(place).rglob("*.so"))
