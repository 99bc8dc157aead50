"""The modules of plug-ins, and the FMUs, that the runs of a study need, and how workers get them.

Workers of this machine import them where they lie. To other machines they travel with the runs, as bytes, and are
written to a folder that exists as long as the worker. Only what was let in here when the scenarios were read travels:
their files, and what these imported from the same folder.
"""

from __future__ import annotations

import hashlib
import sys
import threading
from collections.abc import Iterable
from functools import lru_cache
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from agents.controllers import BUILT_IN, laws
from fleet.addons.studies.errors import StudyError
from fleet.execution.external_agents import has_gateways
from fleet.processes.run_folder import close_at_end
from fleet.scenario.programs import admit_programs
from fleet.scenario.scenario import Scenario
from netem.private_folder import PrivateFolder
from world.plants.classes import file_of, module_of
from world.plugins.loading import unit_file
from world.plugins.trust import ModulePlace, Permission, Trust, find, permit, permitted_file, trusting

MOST_BYTES = 4_000_000  # of all files that travel: they go with each batch of runs
_writing = threading.Lock()


class Modules(NamedTuple):
    """Modules that were let in when the scenarios were read."""

    folder: str | None = None  # of the scenario's file, if they lie in it; None: they lie in the current directory
    files: tuple[str, ...] = ()
    fingerprints: tuple[str, ...] = ()  # SHA-256 of each file, which workers check before they import a module
    names: tuple[str, ...] = ()  # of the modules of laws, plants and checks
    programs: bool = False  # whether programs on the wall clock take part, which are started with each run
    verb: str = "netem"  # the command that makes such a run
    units: tuple[str, ...] = ()  # files of plants that are FMUs, as the scenarios name them
    carried: tuple[tuple[str, bytes], ...] = ()  # path and content of each file, for other machines


NO_MODULES = Modules()


def modules_of(scenarios: Iterable[Scenario], folder: Path | None) -> Modules:
    """The modules of all laws, plants and checks of these scenarios. `folder`: of the scenario's file; modules may lie
    in it."""
    scenarios = list(scenarios)
    if any(scenario.nodes for scenario in scenarios):
        return _stack_modules(scenarios, folder)
    for scenario in scenarios:
        admit_programs(scenario.spec, scenario.reading.policy)  # of gateways
    found = _law_modules(scenarios, folder)
    return found._replace(programs=True, verb="run") if any(map(has_gateways, scenarios)) else found


def _law_modules(scenarios: list[Scenario], folder: Path | None) -> Modules:
    names = {
        law.name.partition(":")[0]
        for scenario in scenarios
        for control in scenario.controls
        for kind, law in laws(control).items()
        if law.name not in BUILT_IN[kind] and ":" in law.name and not unit_file(kind, law.name)
    }
    names |= {module for s in scenarios for name in s.plants if (module := module_of(name)) is not None}
    names |= {name.partition(":")[0] for scenario in scenarios for name in scenario.spec.checks.python or ()}
    beside = () if folder is None else (folder,)
    places = {name: place for name in sorted(names) if (place := find(name, [*beside, Path()])) is not None}
    own = {name: place for name, place in places.items() if not place.installed}
    units = {
        unit: file
        for s in scenarios
        for name in s.plants
        if (unit := unit_file("plant", name)) and (file := file_of(name))
    }
    units |= {
        unit: permitted_file("agent", law.name)
        for s in scenarios
        for control in s.controls
        if (law := control.agent) is not None and (unit := unit_file("agent", law.name))
    }
    files = tuple(dict.fromkeys([*(file for place in own.values() for file in place.files), *map(str, units.values())]))
    digests = tuple(hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in files)
    beside_it = None if folder is None else str(folder.resolve())
    return Modules(beside_it, files, digests, tuple(names), units=tuple(units))


def _stack_modules(scenarios: list[Scenario], folder: Path | None) -> Modules:
    """What runs of programs need: these are let in as a whole, and `fleet netem` imports the checks in Python."""
    for scenario in scenarios:
        admit_programs(scenario.spec, scenario.reading.policy)
    return Modules(folder_of_checks(scenarios, folder), programs=True)


def folder_of_checks(scenarios: Iterable[Scenario], folder: Path | None) -> str | None:
    """Where the checks in Python of some stacks lie: beside the scenario's file, or where the user is, which is None.
    `folder`: of that file. All else that a stack names is absolute by now."""
    beside = [] if folder is None else [folder]
    names = dict.fromkeys(name.partition(":")[0] for one in scenarios for name in one.spec.checks.python or ())
    places = (find(name, [*beside, Path()]) for name in names)
    return next((str(Path(place.folder).resolve()) for place in places if place and not place.installed), None)


def packed(modules: Modules) -> Modules:
    """The same with the content of the files, for workers of other machines. Raises StudyError: a file cannot be read
    or sent."""
    beside = [] if modules.folder is None else [Path(modules.folder)]
    places = [place for name in modules.names if (place := find(name, [*beside, Path()])) and not place.installed]
    found: dict[str, bytes] = {}
    for place in places:
        for file in [*place.files, *_imported_from(place)]:
            try:
                data = Path(file).read_bytes()
            except OSError as error:
                raise StudyError(f"cannot read {file}, which workers need: {error.strerror}") from None
            path = Path(file).resolve().relative_to(Path(place.folder).resolve()).as_posix()
            if found.setdefault(path, data) != data:
                raise StudyError(f"two files {path} in different folders cannot both go to the workers: rename one")
    for unit in modules.units:
        if PurePosixPath(unit).is_absolute() or ".." in PurePosixPath(unit).parts:
            raise StudyError(f"{unit} cannot go to the workers: it must lie beside the scenario")
        lies = next(there for folder in [*beside, Path()] if (there := folder / unit).is_file())
        found[PurePosixPath(unit).as_posix()] = lies.read_bytes()
    if (size := sum(map(len, found.values()))) > MOST_BYTES:
        raise StudyError(f"the laws take {size} bytes, and {MOST_BYTES} can go to the workers: install them there")
    return modules._replace(folder=None, carried=tuple(sorted(found.items())))


def _imported_from(place: ModulePlace) -> list[str]:
    folder = Path(place.folder).resolve()
    found = []
    for name, module in list(sys.modules.items()):
        path, stem = getattr(module, "__file__", None), name.replace(".", "/")
        if path is not None and Path(path).resolve() in (folder / f"{stem}.py", folder / stem / "__init__.py"):
            found.append(path)
    return found


def folder_of(modules: Modules) -> Path | None:
    """Where the modules are looked for on this worker, besides the current folder. Raises StudyError: this worker would
    import another module of that name."""
    if not modules.carried:
        return None if modules.folder is None else Path(modules.folder)
    with _writing:
        folder = _write_files(modules.carried)
    contents = {data for _, data in modules.carried}
    for path in (path for path, _ in modules.carried if path.endswith(".py")):
        name = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        place = find(name, [folder])
        if place is None or not contents.issuperset(Path(file).read_bytes() for file in place.files):
            raise StudyError(f"another module {name} is installed there, or was imported before: restart the worker")
    return folder


def get_ready(modules: Modules) -> None:
    """Import the modules on this worker. Raises StudyError: it would import another module of that name; PluginError: a
    module may not run; Exception: whatever importing it raises."""
    folder = folder_of(modules)
    beside = () if folder is None else (folder,)
    permission = Permission(elsewhere=(*beside, Path()))
    with trusting(Trust(fingerprints=frozenset(modules.fingerprints))):
        for name in modules.names:
            permit("law", name, name, permission)
            import_module(name)


@lru_cache
def _write_files(files: tuple[tuple[str, bytes], ...]) -> Path:
    private = PrivateFolder("laws")
    close_at_end(private)
    folder = private.path
    for path, data in files:
        if PurePosixPath(path).is_absolute() or ".." in PurePosixPath(path).parts:
            raise ValueError(path)
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
    return folder
