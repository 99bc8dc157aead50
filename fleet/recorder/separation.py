"""The smallest distance between any two vehicles, frame by frame."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from math import isnan
from typing import NamedTuple

import numpy as np

from fleet.quantities import vehicle_numbers
from fleet.scenario.scenario import Scenario
from netem.wire.messages import Frame

_AT_ONCE = 50_000  # distances that are computed at once: half a megabyte each


class Nearest(NamedTuple):
    """The distance of two vehicles at a tick."""

    distance_m: float
    pair: tuple[int, int]
    tick: int


class Separation:
    """The least true distance of some vehicles over the frames from a tick on. All pairs of several frames are computed
    at once: 1 us a frame for 4 vehicles, 0.05 ms for 100, less than a hundredth of the time of a tick.
    """

    def __init__(self, vehicles: Sequence[int], after: int = 0) -> None:
        """`vehicles`: their numbers, ascending. `after`: the first tick that counts."""
        self._vehicles, self._after = tuple(vehicles), after
        self._wanted = frozenset(vehicles)
        self._i, self._j = np.triu_indices(len(vehicles), 1)
        self._most = max(1, _AT_ONCE // max(1, len(self._i)))
        self._ticks, self._places = array("q"), array("d")  # frames that are still to be looked at
        self._least: Nearest | None = None

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> Separation | None:
        """The input that the scenario's check needs; None if it has no such check."""
        check = scenario.spec.checks.min_separation
        if check is None:
            return None
        everyone = range(1, scenario.vehicles + 1)
        some = vehicle_numbers(check.vehicles) if check.vehicles else everyone
        return cls(sorted(set(some)), -(-check.after // scenario.tick_ns))

    def frame(self, frame: Frame) -> None:
        if frame.tick < self._after or len(self._vehicles) < 2:
            return
        self._ticks.append(frame.tick)
        for row in frame.vehicles:
            if row.id in self._wanted:
                self._places.extend(row.eta[:3])
        if len(self._ticks) == self._most:
            self._look()

    @property
    def least(self) -> Nearest | None:
        """The least distance so far; None before the first frame that counts."""
        if self._ticks:
            self._look()
        return self._least

    def _look(self) -> None:
        x, y, z = np.array(self._places).reshape(len(self._ticks), -1, 3).T  # each by vehicle and frame
        i, j = self._i, self._j
        squared = (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2 + (z[i] - z[j]) ** 2
        # The least one, or one of a position that is no number, if there is one.
        pair, frame = divmod(int(squared.argmin()), len(self._ticks))
        distance = float(squared[pair, frame]) ** 0.5
        if self._least is None or isnan(distance) or distance < self._least.distance_m:
            vehicles = self._vehicles[self._i[pair]], self._vehicles[self._j[pair]]
            self._least = Nearest(distance, vehicles, self._ticks[frame])
        del self._ticks[:], self._places[:]
