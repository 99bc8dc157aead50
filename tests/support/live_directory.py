"""The directory of a live run of ours, in which nobody answers."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fleet.execution.directory import RunDirectory
from fleet.execution.registry import register

CONNECTION = {"endpoint": "tcp/127.0.0.1:1", "run": "a", "user": "u", "password": "p"}


@contextmanager
def live_directory(out: Path, scenario: str = "paper", *, text: str = "", **more: Any) -> Iterator[Path]:
    """A run that is registered and holds its lock while the block lasts.

    Args:
        text: of its scenario.
        more: fields of its connection file besides, or in place of, the usual ones.
    """
    directory = RunDirectory(out, scenario, 1)
    directory.write_scenario(text)
    directory.write_connection(CONNECTION | {"scenario": scenario, "pid": os.getpid()} | more)
    link = register(directory)
    try:
        yield directory.path
    finally:
        link.unlink(missing_ok=True)
        directory.close()
