"""Pages that are notebooks: blocks of Python, each with what it prints below it."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

_BLOCK = re.compile(r"```python\n(?P<code>.*?)```\n(?:\n```text\n(?P<printed>.*?)```\n)?", re.DOTALL)


def run_page(page: Path) -> int:
    """Run the code of a page from top to bottom; returns how many blocks it has.

    Raises:
        AssertionError: a block prints something else than the page shows.
    """
    names: dict[str, Any] = {}
    blocks = list(_BLOCK.finditer(page.read_text("utf-8")))
    for block in blocks:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(block["code"], names)
        assert printed.getvalue() == (block["printed"] or "")
    return len(blocks)
