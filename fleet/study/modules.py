"""The modules of laws that the runs of a study import and that are not installed, and how workers get them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from agents.controllers import BUILT_IN, laws
from agents.plugins.trust import find
from fleet.scenario.scenario import Scenario


class Modules(NamedTuple):
    """Modules that were let in when the scenarios were read.

    Attributes:
        folder: of the scenario's file on this machine, in which they may lie; else they lie in the current one.
        files: of the modules.
        fingerprints: SHA-256 of each file, by which workers let them in, too.
    """

    folder: str | None = None
    files: tuple[str, ...] = ()
    fingerprints: tuple[str, ...] = ()


NO_MODULES = Modules()


def modules_of(scenarios: Iterable[Scenario], folder: Path | None) -> Modules:
    """The modules of all laws of these scenarios.

    Args:
        folder: of the scenario's file, in which laws may lie.
    """
    names = {
        law.name.partition(":")[0]
        for scenario in scenarios
        for control in scenario.controls
        for kind, law in laws(control).items()
        if law.name not in BUILT_IN[kind] and ":" in law.name  # others are entry points, which are installed
    }
    beside = () if folder is None else (folder,)
    places = [place for name in sorted(names) if (place := find(name, [*beside, Path()])) is not None]
    files = tuple(dict.fromkeys(file for place in places if not place.installed for file in place.files))
    digests = tuple(hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in files)
    return Modules(None if folder is None else str(folder.resolve()), files, digests)
