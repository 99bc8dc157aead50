"""The library that is preloaded into programs, and what starts them: compiled with the wheel, or at the first use."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
from contextlib import suppress
from functools import cache
from pathlib import Path

from fleet.errors import FleetError
from netem.private_folder import PrivateFolder

SOURCES = Path(__file__).parent / "preload"
LIBRARY, LAUNCHER = "libfleet_preload.so", "fleet_launch"


class NoLibraryError(FleetError):
    """Programs cannot run in simulated time on this machine."""


@cache
def compile_library() -> tuple[Path, Path]:
    """The library and the launcher.

    Returns:
        Their files: those of the wheel, which lie beside the sources; else compiled into the user's cache, once for
        each version of the sources.

    Raises:
        NoLibraryError: it is no Linux on x86-64, or there is no compiler.
    """
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        raise NoLibraryError(
            f"programs in simulated time need Linux on x86-64; this is {platform.system()} on {platform.machine()}. "
            "On the wall clock they run anywhere: fleet netem"
        )
    if (SOURCES / LIBRARY).is_file() and os.access(SOURCES / LAUNCHER, os.X_OK):
        return SOURCES / LIBRARY, SOURCES / LAUNCHER
    folder = _cache() / _mark()
    if not (folder / LIBRARY).is_file():
        try:
            _compile_into(folder)
        except OSError as error:
            raise NoLibraryError(f"the library for programs cannot be put into {folder.parent}: {error}") from None
    return folder / LIBRARY, folder / LAUNCHER


def compile_preload(folder: Path) -> None:
    """Compile both into a folder. Raises CalledProcessError and OSError: the compiler fails, or there is none."""
    compiler = (os.environ.get("CC") or "cc").split()[0]
    if shutil.which(compiler) is None:
        raise FileNotFoundError(2, "there is no compiler", compiler)
    subprocess.run(["sh", str(SOURCES / "compile.sh"), str(folder)], check=True, capture_output=True, text=True)


def _compile_into(folder: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    with PrivateFolder("compiling", folder.parent) as temporary:
        new = temporary / "new"
        new.mkdir()
        try:
            compile_preload(new)
        except FileNotFoundError as error:
            raise NoLibraryError(
                f"programs in simulated time need a C compiler, there is no {error.filename}: install gcc, or set CC"
            ) from None
        except subprocess.CalledProcessError as error:
            raise NoLibraryError(f"the library for programs does not compile: {error.stderr:.500}") from None
        with suppress(OSError):  # several processes may compile at the same time: the first one's stays
            new.rename(folder)


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "uuv-fleet" / "preload"


def _mark() -> str:
    whole = hashlib.sha256()
    for path in sorted([*SOURCES.glob("*.[ch]"), *SOURCES.glob("launcher/*.c"), SOURCES / "compile.sh"]):
        whole.update(path.read_bytes())
    return whole.hexdigest()[:20]
