"""The errors of studies."""

from __future__ import annotations

from fleet.errors import FleetError, printable


class StudyError(FleetError):
    """A study that cannot be made, run or read. Its words may be those of a stranger's files."""

    def __init__(self, message: str = "", status: int | None = None) -> None:
        super().__init__("\n".join(map(printable, message.split("\n"))), status)
