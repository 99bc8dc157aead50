"""The names of the signals of a log, without reading all of it."""

from __future__ import annotations

import json
import re
from pathlib import Path

from fleet.logs.reader import LogReader, log_path
from fleet.scenario.sections.signals import GROUPS


def signal_names(path: Path) -> list[str]:
    """Every signal of a vehicle as its channels declare it: `control.leads`; read from the beginning of the file.

    Raises:
        LogReadError: there is no log to read.
    """
    reader = LogReader(log_path(path))
    next(iter(reader.blocks()), None)
    found: dict[str, None] = {}
    for channel in reader.channels.values():
        group = re.fullmatch(r"uuv/\d+/(\w+)", channel.topic)
        if group is None or group[1] not in GROUPS:
            continue
        try:
            fields = list(json.loads(channel.metadata["units"]))
        except (KeyError, ValueError, TypeError):  # a channel that is not ours
            continue
        found |= {f"{group[1]}.{field}": None for field in fields if isinstance(field, str)}
    return sorted(found)
