"""The current directory does not shadow what Python itself needs."""

from __future__ import annotations

import os


def children_ignore_the_folder() -> None:
    """Python processes that start from now on do not import a `socket.py` in the current directory for Python's."""
    os.environ["PYTHONSAFEPATH"] = "1"
