"""Files that a plug-in keeps from one life of its agent to the next, as on the disk of a computer that stays."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from netem.private_folder import PrivateFolder


class KeptFiles:
    """The folders of the plug-ins of one run. They are made when somebody asks for the first one."""

    def __init__(self, place: Path | None = None) -> None:
        """`place`: a folder that somebody else removes when the run is over; None: a private one, until `close`."""
        self._place, self._owner = place, os.getpid()
        self._own: PrivateFolder | None = None

    def folder(self, name: str) -> Path:
        """The folder of a plug-in by its name, the same in each life. Raises OSError: it cannot be made."""
        if self._place is None:
            self._own = PrivateFolder("kept")
            self._place = self._own.path
        path = self._place / name
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        return path

    def close(self) -> None:
        """Remove what is private. In a copy of the process by fork: nothing."""
        if self._own is not None and os.getpid() == self._owner:
            self._own.close()
            self._own = self._place = None

    def __del__(self) -> None:
        if not sys.is_finalizing():
            self.close()


_files: ContextVar[KeptFiles | None] = ContextVar("files", default=None)


@contextmanager
def files_are_kept(files: KeptFiles) -> Iterator[None]:
    """Give the plug-ins that are made inside their folders of a run."""
    token = _files.set(files)
    try:
        yield
    finally:
        _files.reset(token)


def kept_folder(name: str) -> Path | None:
    """The folder of a plug-in that is being made; None: nobody keeps files here. Raises OSError: it cannot be made."""
    files = _files.get()
    return None if files is None else files.folder(name)
