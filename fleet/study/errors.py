"""The errors of studies."""

from __future__ import annotations

from fleet.errors import FleetError


class StudyError(FleetError):
    """A study that cannot be made, run or read."""
