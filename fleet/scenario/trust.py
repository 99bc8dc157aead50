"""The origin of a scenario, and the modules that may be imported for it; see `world.plugins.trust`.

A name on the command line is trusted as the user's own; so is a scenario file in the current directory or below it.
A log, the scenario in a run directory and a file from elsewhere are foreign.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fleet.errors import Problem
from world.plugins.loading import admit
from world.plugins.trust import Permission

A_LOG = "a log names it"


@dataclass(frozen=True, slots=True)
class Policy:
    """The modules that may be imported while a scenario is read."""

    stranger: str = A_LOG  # why only installed modules may be named; "": the user's own scenario
    imports: bool = True  # False: a law that the text names is taken by its name, and nothing is imported
    # Collects the laws that may not run, and of a log those that are not there; None: they are errors.
    refused: list[Problem] | None = None
    typed: bool = True  # what overrides the text was typed on the command line
    checks: bool = True  # False: nothing is judged, so checks in Python are not imported

    @property
    def of_a_log(self) -> bool:
        """Whether the text comes from a log, and is read without the laws that may not run or are not there."""
        return self.refused is not None and self.stranger == A_LOG

    def admit(self, kind: str, name: str, folder: Path | None, *, typed: bool) -> None:
        """Let the module of a plug-in be imported if it may run. `typed`: an override names it.

        Raises UntrustedError: it may not; PluginError: the name is none of a plug-in.
        """
        beside = () if folder is None else (folder,)
        own = () if self.stranger else beside
        if typed and self.typed:
            own = (Path(), *own)
        because = self.stranger or "the scenario is not beside it"
        admit(kind, name, Permission(own, (*beside, Path()), because))


READING = Policy(imports=False)
RECORDS = ("run.mcap", "result.json")  # in the directory of a run; one of them may not be there


@dataclass(frozen=True, slots=True)
class OverrideOrigin:
    """Where overrides come from: the command line, or the file of a study."""

    stranger: str = ""  # why only installed modules may be named, in the scenario, too; "": the user's own
    typed: bool = True  # a law that they name may lie in the current directory


TYPED = OverrideOrigin()


def origin(file: Path) -> OverrideOrigin:
    """That of the overrides in a file, which obeys the rules of a scenario's file."""
    why = stranger(file)
    return OverrideOrigin(why, not why and file.parent.resolve() == Path().resolve())


def stranger(file: Path) -> str:
    """Why a scenario's file may name no module that is not installed; "": it is the user's own."""
    folder = file.parent.resolve()
    if not folder.is_relative_to(Path().resolve()):
        return "the scenario that names it lies outside of the current directory"
    if file.name == "scenario.yaml" and any((folder / name).exists() for name in RECORDS):
        return "the scenario that names it is the record of a run"
    return ""
