"""Files that are there whole or not at all: written under another name, and named when they are finished."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write what shall become `path` at the end; an error or Ctrl-C on the way leaves nothing."""
    if path.exists() and not path.is_file():  # a device or a pipe, which cannot replace another file
        yield path
        return
    path = Path(os.path.realpath(path))  # what a link points to is replaced, not the link
    part = path.with_name(f"{path.stem}.part{path.suffix}")  # some writers go by the suffix
    try:
        yield part
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
