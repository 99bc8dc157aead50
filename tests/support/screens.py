"""Screens as they are expected, in tests/expected; `WRITE_SCREENS=1 pytest ...` writes them anew, to be read."""

from __future__ import annotations

import os

from repository import EXPECTED


def assert_screen(name: str, shown: str) -> None:
    """Fail unless this is the text of tests/expected/screen-<name>.txt."""
    path = EXPECTED / f"screen-{name}.txt"
    if os.environ.get("WRITE_SCREENS"):
        path.write_text(shown, "utf-8")
    assert shown == path.read_text("utf-8"), f"if this is meant: WRITE_SCREENS=1 pytest, and read {path}"
