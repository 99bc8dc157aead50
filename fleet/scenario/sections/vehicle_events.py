"""The events of vehicles in a run, apart from its faults: how often each tumbled or diverged.

A vehicle that tumbles ten times is one thing to know, not ten; and it is a consequence of the faults, not one of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from msgspec import Meta, Struct


class VehicleEvents(Struct):
    """All events of one kind that happened to one vehicle."""

    what: Annotated[str, Meta(description="Which event, and which vehicle: `tumbled 3`.")]
    times: int
    first_s: float

    def __str__(self) -> str:
        """A line such as `tumbled 3: 10 times, first at 12.45 s`."""
        return f"{self.what}: {f'{self.times} times, first ' if self.times > 1 else ''}at {self.first_s:.10g} s"


def vehicle_events(happened: Iterable[tuple[str, float]]) -> list[VehicleEvents]:
    """One row for each vehicle and kind of event, in the order of their first occurrence.

    `happened`: text and beginning [s] of each event, in any order.
    """
    times: dict[str, list[float]] = {}
    for what, at_s in happened:
        times.setdefault(what, []).append(at_s)
    rows = [VehicleEvents(what, len(some), min(some)) for what, some in times.items()]
    return sorted(rows, key=lambda row: (row.first_s, row.what))
