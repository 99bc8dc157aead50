"""What ends a benchmark before its last figure."""

from __future__ import annotations

from fleet.errors import FleetError


class BenchError(FleetError):
    """A measurement did not come to its end.

    `status` is 3, or for a run that a signal ended what `fleet run` would exit with.
    """

    status = 3

    def __init__(self, reason: str, status: int = 3) -> None:
        super().__init__(reason)
        self.status = status
