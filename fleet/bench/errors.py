"""What ends a benchmark before its last figure."""

from __future__ import annotations

from pathlib import Path

from fleet.errors import FleetError


class BenchError(FleetError):
    """A measurement did not come to its end.

    `status` is 3, or for a run that a signal ended what `fleet run` would exit with.
    """

    status = 3

    def __init__(self, reason: str, status: int = 3) -> None:
        super().__init__(reason)
        self.status = status


class FiguresError(FleetError):
    """A file is not what `fleet bench -o` writes, or cannot be read."""

    status = 2

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path, self.reason = path, reason
