"""The names of topics with numbers in them, such as `link/1-2`, and of the signals that a log has."""

from __future__ import annotations

import json
import re
from pathlib import Path

from fleet.mcap.reader import LogReader, log_path
from fleet.scenario.sections.signals import GROUPS
from netem.condition import Link

_LINK = re.compile(r"link/(\d{1,9})-(\d{1,9})", re.ASCII)
_BELIEVER = re.compile(r"uuv/(\d{1,9})/(belief|located)", re.ASCII)
BELIEFS = ("uuv/*/belief", "uuv/*/located")  # what vehicles believe of their places, by navigator and by ranges


def said_topic(i: int) -> str:
    """The lines that vehicle i's agent said."""
    return f"said/{i}"


def link_topic(link: Link) -> str:
    return f"link/{link[0]}-{link[1]}"


def link_of(topic: str) -> Link | None:
    """The link of a topic; None: it is another topic."""
    found = _LINK.fullmatch(topic)
    return None if found is None else (int(found[1]), int(found[2]))


def believer_of(topic: str) -> tuple[int, str] | None:
    """The vehicle that holds the beliefs in a topic, and `belief` or `located`; None: it is another topic."""
    found = _BELIEVER.fullmatch(topic)
    return None if found is None else (int(found[1]), found[2])


def signal_names(path: Path) -> list[str]:
    """Every signal of a vehicle as its channels declare it: `control.leads`; read from the beginning of the file.
    Raises LogReadError if there is no log to read.
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
