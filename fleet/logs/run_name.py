"""The name of a run is that of its directory; only this name says when the run began."""

from __future__ import annotations

import os
import re
from datetime import UTC, datetime
from pathlib import Path

STAMP = "%Y%m%d-%H%M%S"  # in the names of run directories, UTC
RUN_NAME = re.compile(r"(?P<scenario>.+)-(?P<seed>\d+)-(?P<began>\d{8}-\d{6})(-\d+)?", re.ASCII)


def run_name(log: Path) -> str:
    """The name of the run directory, links such as `latest` resolved, or of a log that is not called run.mcap."""
    path = Path(os.path.realpath(log))
    return path.parent.name if path.name == "run.mcap" else path.stem


def begin_time(name: str) -> datetime | None:
    """When the run of a name began, in UTC; None: the name does not say it, because somebody gave it another one."""
    found = RUN_NAME.fullmatch(name)
    try:
        return None if found is None else datetime.strptime(found["began"], STAMP).replace(tzinfo=UTC)
    except ValueError:  # no day has this number
        return None
