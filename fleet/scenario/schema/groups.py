"""The groups of the shipped scenarios in `fleet list`."""

from __future__ import annotations

from typing import Literal, get_args

Group = Literal["start here", "network", "faults", "acoustics", "protocols", "vehicles"]
GROUPS: tuple[str, ...] = get_args(Group)  # in the order of the list
