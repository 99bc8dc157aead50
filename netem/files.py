"""Files that are there as a whole or not at all: what holds keys and passwords, and what others read meanwhile."""

from __future__ import annotations

import os
from pathlib import Path
from secrets import token_hex


def write_whole(path: Path, data: bytes, mode: int = 0o600) -> None:
    """Make a file, or replace it: nobody sees a part of it, and it never has another mode.

    Raises:
        OSError: it cannot be written; nothing is left behind, and what was there before stays.
    """
    temporary = path.with_name(f".{path.name}-{token_hex(4)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
