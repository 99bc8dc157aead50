"""The live runs of this user, wherever their directories are: a private folder with a link to each.

A link holds no secret, and none is believed: whether a run lives, says the lock in its directory. Links that a
killed run left are removed by whoever looks.
"""

from __future__ import annotations

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

from fleet.errors import FleetError
from fleet.execution.directory import RunDirectory, is_in_use, remove_secrets

NAME = "uuv-fleet"
FALLBACK = Path("/tmp")


class RegistryError(FleetError):
    """The folder cannot be made, or it may be somebody else's; runs are found by their directories only."""

    status = 3


def folder() -> Path:
    """Where the links are: `$XDG_RUNTIME_DIR/uuv-fleet`, or below /tmp when this user has no such directory."""
    runtime = Path(os.environ.get("XDG_RUNTIME_DIR", ""))
    with suppress(OSError):
        if runtime.is_absolute() and runtime.stat().st_uid == os.getuid():
            return runtime / NAME
    return FALLBACK / f"{NAME}-{os.getuid()}"


def register(run: RunDirectory) -> Path:
    """Add a run that lives; returns its link, to be removed when the run is over. Raises RegistryError if the folder
    cannot be made, written or trusted, or the run could not be told from a dead one.
    """
    if not run.locked:
        raise RegistryError(f"the file system of {run.path} has no locks")
    place = folder()
    link = place / secrets.token_hex(8)
    try:
        place.mkdir(mode=0o700, exist_ok=True)
        _check(place)
        link.symlink_to(run.path.absolute())
    except OSError as error:
        raise RegistryError(f"cannot write to {place}: {error.strerror}") from None
    return link


def registered_runs() -> list[Path]:
    """The directories of all runs that live; links of others are removed. Raises RegistryError if the folder cannot be
    read or trusted.
    """
    place = folder()
    try:
        _check(place)
        links = [Path(entry) for entry in os.scandir(place) if entry.is_symlink()]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise RegistryError(f"cannot read {place}: {error.strerror}") from None
    found: set[Path] = set()
    for link in links:
        with suppress(OSError):  # the run has ended meanwhile
            directory = link.readlink()
            if is_in_use(directory):
                found.add(directory)
            else:
                remove_secrets(directory)
                link.unlink()
    return sorted(found)


def _check(place: Path) -> None:
    found = place.lstat()
    if not stat.S_ISDIR(found.st_mode):
        raise RegistryError(f"{place} is no folder; remove it")
    if found.st_uid != os.getuid():
        raise RegistryError(f"{place} belongs to another user (number {found.st_uid}); set XDG_RUNTIME_DIR")
    mode = stat.S_IMODE(found.st_mode)
    if mode != 0o700:
        raise RegistryError(f"{place} has mode {mode:04o}, expected 0700: chmod 700 {place}")
