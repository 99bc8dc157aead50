"""A vehicle's own estimate of its position over time, read from the log of a run.

The estimate uses ranges if the vehicle measured any. Otherwise it is that of its navigator.

| topic | content |
|---|---|
| `uuv/<i>/belief` | estimate of the navigator, with depth and formation error |
| `uuv/<i>/located` | north and east by navigator and ranges; only for vehicles that use ranges |
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fleet.logs.open_log import Log
from fleet.logs.topic import Topic
from fleet.mcap.records import Array
from fleet.scenario.sections.signals import OF_LOCALIZATION, OF_NAVIGATION


class Beliefs(NamedTuple):
    """The estimate of one vehicle over time, and its error."""

    t: Array  # s
    off: Array  # believed minus true position (samples, 3) [m, NED]
    covariance: Array  # of north and east: nn, ne, ee (samples, 3) [m^2]
    formation: Array  # believed position minus desired position (samples, 3) [m, NED]
    step_s: float  # between two samples; 0: not known

    @property
    def formation_norm(self) -> Array:
        """The formation error as the vehicle believes it (samples) [m]."""
        norm: Array = np.linalg.norm(self.formation, axis=1)
        return norm


def beliefs(log: Log, i: int) -> Beliefs | None:
    """The estimate of vehicle i. None: the vehicle knew its position, the log lacks the estimate, or has too many
    samples of it.
    """
    known = _topic(log, i, OF_NAVIGATION, {"off": 3, "covariance": 10, "formation": 3})
    if known is None:
        return None
    t, off, formation = known.t, known["off"], known["formation"]
    located = _topic(log, i, OF_LOCALIZATION, {"off": 2, "covariance": 3})
    if located is None:
        return Beliefs(t, off, known["covariance"][:, (0, 1, 4)], formation, known.step_ns / 1e9)
    at = located.t
    true = _interpolate(at, t, formation - off)  # formation error
    off = np.column_stack([located["off"], _interpolate(at, t, off[:, 2:])])
    return Beliefs(at, off, located["covariance"], true + off, located.step_ns / 1e9)


def _topic(log: Log, i: int, group: str, widths: dict[str, int]) -> Topic | None:
    name = f"uuv/{i}/{group}"
    if name not in log:
        return None
    found = log[name]
    if found.too_many or not len(found):
        return None
    shapes = {signal: (len(found), width) for signal, width in widths.items()}
    # A log of somebody else may have other signals under these names.
    return found if all(signal in found and found[signal].shape == of for signal, of in shapes.items()) else None


def _interpolate(at: Array, t: Array, values: Array) -> Array:
    """The columns of values at other times: topics may be logged at different rates."""
    if np.array_equal(at, t):
        return values
    return np.column_stack([np.interp(at, t, column) for column in values.T])
