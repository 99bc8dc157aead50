"""The archive of an FMU: looked at without running anything of it, and unpacked into a private folder."""

from __future__ import annotations

import shutil
import stat
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from netem.limits import FMU, FMU_DESCRIPTION
from world.errors import FmuError

DESCRIPTION = "modelDescription.xml"
MAX_DIRECTORY_BYTES = 4 << 20  # of the list of files
_SIZE_OF_DIRECTORY = 5  # in what zipfile says of the end of an archive
# Folders of the binaries for one platform, of FMI 3 and of FMI 2.
PLATFORMS = {
    "x86_64-linux": "linux64",
    "aarch64-linux": "aarch64-linux",
    "x86-linux": "linux32",
    "x86_64-windows": "win64",
    "x86-windows": "win32",
    "x86_64-darwin": "darwin64",
    "aarch64-darwin": "aarch64-darwin",
}


@contextmanager
def archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """The archive of an FMU, with every name and size in it checked. Raises FmuError: it cannot be read, is none, or
    holds what must not be unpacked."""
    try:
        with path.open("rb") as file:
            _check_directory(file)
            with zipfile.ZipFile(file) as opened:
                _check(opened)
                yield opened
    except OSError as error:
        raise FmuError(f"cannot be read: {error.strerror or error}") from None
    except (zipfile.BadZipFile, zipfile.LargeZipFile, EOFError, ValueError) as error:
        raise FmuError(f"is no FMU: {str(error)[:200]}", "an FMU is a zip file with a modelDescription.xml") from None
    except (NotImplementedError, RuntimeError) as error:  # a method of packing that is not known; a password
        raise FmuError(f"cannot be unpacked: {str(error)[:200]}", "export it again") from None


def _check_directory(file: IO[bytes]) -> None:
    """Check that the list of files is small enough: each entry takes ten times as much memory as in the archive."""
    end = zipfile._EndRecData(file)  # type: ignore[attr-defined]  # the same that zipfile goes by
    if end and end[_SIZE_OF_DIRECTORY] > MAX_DIRECTORY_BYTES:
        raise FmuError(f"lists its files in {end[_SIZE_OF_DIRECTORY]} bytes: more than {FMU.items} are not unpacked")


def _check(opened: zipfile.ZipFile) -> None:
    files = opened.infolist()
    if len(files) > FMU.items:
        raise FmuError(f"holds {len(files)} files: more than {FMU.items} are not unpacked")
    for file in files:
        name = PurePosixPath(file.filename)
        if name.is_absolute() or ".." in name.parts or "\\" in file.filename or ":" in file.filename:
            raise FmuError(f"would unpack {file.filename[:100]!r}, which lies outside of its folder", "do not trust it")
        if stat.S_ISLNK(file.external_attr >> 16):
            raise FmuError(f"holds the link {file.filename[:100]!r}: only files are unpacked", "export it again")
    if (size := sum(file.file_size for file in files)) > FMU.bytes:
        raise FmuError(f"would be {size >> 20} MiB unpacked: more than {FMU.bytes >> 20} MiB are not unpacked")
    by_name = {file.filename: file for file in files}
    if (description := by_name.get(DESCRIPTION)) is None:
        raise FmuError(f"is no FMU: it has no {DESCRIPTION}")
    if description.file_size > FMU_DESCRIPTION.bytes:
        raise FmuError(f"has a {DESCRIPTION} of {description.file_size >> 20} MiB", "it has too many variables")


def platforms(opened: zipfile.ZipFile) -> list[str]:
    """The folders in `binaries/` that have files in them."""
    parts = (PurePosixPath(name).parts for name in opened.namelist() if not name.endswith("/"))
    return sorted({part[1] for part in parts if len(part) > 2 and part[0] == "binaries"})


def unpack(path: Path, folder: Path) -> None:
    """Unpack the description, the binaries and the resources of an FMU. Raises FmuError: it cannot be unpacked, or
    holds what must not be."""
    with archive(path) as opened:
        for file in opened.infolist():
            first = PurePosixPath(file.filename).parts[:1]
            if file.is_dir() or not (file.filename == DESCRIPTION or first in (("binaries",), ("resources",))):
                continue
            target = folder / file.filename
            target.parent.mkdir(parents=True, exist_ok=True)
            # No more than the declared size is read, and a wrong checksum is an error.
            with opened.open(file) as packed, target.open("wb") as unpacked:
                shutil.copyfileobj(packed, unpacked)
