"""The vehicles that have an agent at a tick, and the number of that agent's life.

An agent that ended leaves its vehicle without one from a tick on, until another is started in its place: a new
incarnation, with an empty memory. Both are ticks, so every process computes the same answer for the same tick.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import NamedTuple

from netem.errors import OutOfPlace


class Absence(NamedTuple):
    """A vehicle has no agent from tick `begin` to before `end` (None: to the end of the run)."""

    vehicle: int
    begin: int
    end: int | None = None


class Lives:
    """The absences of every vehicle. They may overlap: it has an agent whenever none of them lasts."""

    def __init__(self, absences: Iterable[Absence] = ()) -> None:
        self.absences: list[Absence] = []
        self._gaps: dict[int, list[tuple[float, float]]] = {}  # by vehicle: what the absences add up to, ascending
        self.absences += absences
        for i in {absence.vehicle for absence in self.absences}:
            self._add_up(i)

    def lacks_agent(self, i: int, tick: int) -> bool:
        return i in self._gaps and any(begin <= tick < end for begin, end in self._gaps[i])

    def incarnation(self, i: int, tick: int) -> int:
        """How often vehicle i's agent has been restarted up to a tick."""
        return sum(end <= tick for _, end in self._gaps[i]) if i in self._gaps else 0

    def check(self, i: int, tick: int, incarnation: int) -> int:
        """The incarnation of vehicle i's agent at a tick, which a message of it must name. Raises OutOfPlace: the
        message names another incarnation."""
        expected = self.incarnation(i, tick)
        if incarnation != expected:
            raise OutOfPlace("incarnation", expected, incarnation)
        return incarnation

    def gaps(self, i: int) -> list[tuple[int, int | None]]:
        """From when to before when vehicle i has no agent: life n ends with gap n, both counted from 0."""
        return [(int(begin), None if end == inf else int(end)) for begin, end in self._gaps.get(i, ())]

    def add(self, absence: Absence) -> None:
        self.absences.append(absence)
        self._add_up(absence.vehicle)

    def leave_out(self, absence: Absence) -> None:
        """Drop an absence, which has not begun."""
        self.absences.remove(absence)
        self._add_up(absence.vehicle)

    def end(self, i: int, tick: int, until: int | None = None) -> None:
        """Vehicle i's agent ended at a tick on its own. `tick`: the first tick without the agent. `until`: another
        agent takes over at this tick. None: the next planned restart brings the agent back."""
        if until is not None:
            self.add(Absence(i, tick, until))
        elif not self.lacks_agent(i, tick):
            self.add(Absence(i, tick, next((end for _, end in self.gaps(i) if end is None or end > tick), None)))

    def restart(self, i: int, begin: int | None, tick: int) -> None:
        """The absences of vehicle i that began at `begin` (None: whenever) and last at `tick` end there."""
        self.absences = [
            a._replace(end=tick)
            if a.vehicle == i and begin in (None, a.begin) and a.begin < tick and (a.end is None or tick < a.end)
            else a
            for a in self.absences
        ]
        self._add_up(i)

    def _add_up(self, i: int) -> None:
        gaps: list[tuple[float, float]] = []
        for begin, end in sorted((a.begin, inf if a.end is None else a.end) for a in self.absences if a.vehicle == i):
            if gaps and begin < gaps[-1][1]:
                gaps[-1] = gaps[-1][0], max(gaps[-1][1], end)
            elif begin < end:
                gaps.append((begin, end))
        self._gaps[i] = gaps
