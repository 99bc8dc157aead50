"""The origin of a scenario, and the modules that may be imported for it; see `world.plugins.trust`.

A name on the command line is trusted as the user's own; so is a scenario file in the current directory or below it. A
log, the scenario in a run directory and a file from elsewhere are foreign, unless this user has run that very scenario
with modules of their own. Then these modules may run for its log as well.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fleet.errors import Problem
from netem.files import read_file
from netem.limits import TRUSTED
from netem.whole_file import write_whole
from world.plugins.loading import admit
from world.plugins.trust import Permission, own_folders, permit_command

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
    own: tuple[Path, ...] = ()  # folders whose modules may run although the text is a stranger's: see `ran_from`

    @property
    def of_a_log(self) -> bool:
        """Whether the text comes from a log, and is read without the laws that may not run or are not there."""
        return self.refused is not None and self.stranger == A_LOG

    def admit(self, kind: str, name: str, folder: Path | None, *, typed: bool) -> None:
        """Let the module of a plug-in be imported if it may run. `typed`: an override names it.

        Raises UntrustedError: it may not; PluginError: the name is none of a plug-in.
        """
        beside = () if folder is None else (folder,)
        own = self.own if self.stranger else (*beside, Path(), *self.own)
        if typed and self.typed:
            own = (Path(), *own)
        admit(kind, name, Permission(own, (*beside, Path()), self.stranger or "the scenario is not beside it"))

    def admit_program(self, name: str, command: str, folder: str) -> None:
        """Let a program of a node be started if the user asked for it. Raises UntrustedError: it may not run."""
        permit_command(name, command, folder, Permission(self.own, because=self.stranger) if self.stranger else None)


READING = Policy(imports=False)
RECORDS = ("run.mcap", "result.json")  # a run's directory has both, or one of the two


@dataclass(frozen=True, slots=True)
class OverrideOrigin:
    """Where overrides come from: the command line, or the file of a study."""

    stranger: str = ""  # why only installed modules may be named, in the scenario, too; "": the user's own
    typed: bool = True  # a law that they name may lie in the current directory


TYPED = OverrideOrigin()


def origin(file: Path) -> OverrideOrigin:
    """The origin of overrides that are read from a file: they are trusted as little as a scenario file."""
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


def _trust_file() -> Path:
    """The file of this user, mode 0600, with a line for each scenario that was run with own modules."""
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    return (state if state.is_absolute() else Path("~/.local/state").expanduser()) / "uuv-fleet" / "own-runs"


def remember(text: str) -> None:
    """Keep where the own modules lie with which the scenario of a run runs now, so that its log may use them later.

    Nothing is kept of a scenario without any, or if the file cannot be written: then its log needs --trust.
    """
    if not (folders := own_folders()):
        return
    digest = _digest(text)
    with suppress(OSError, RuntimeError):  # no room, or a user without a home
        file = _trust_file()
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        known = _lines(file)
        new = [line for folder in folders if "\n" not in folder and (line := f"{digest} {folder}") not in known]
        if new:
            write_whole(file, "".join(f"{line}\n" for line in [*known, *new][-TRUSTED.items :]).encode())


def ran_from(text: str) -> tuple[Path, ...]:
    """The folders of own modules with which this user has run a scenario, newest first; none: it was not this user."""
    digest = _digest(text)
    with suppress(OSError, RuntimeError):
        parts = (line.partition(" ") for line in _lines(_trust_file()))
        return tuple(Path(folder) for known, _, folder in parts if known == digest)[::-1]
    return ()


def _lines(file: Path) -> list[str]:
    return read_file(file, TRUSTED.bytes).decode("utf-8", "replace").splitlines() if file.exists() else []


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
