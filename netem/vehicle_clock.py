"""The clocks of vehicles: what a clock shows at a moment of simulated time. The only place where the two are related.

| symbol | meaning | unit |
|---|---|---|
| t | simulated time, which is true | s |
| theta, rho | offset and drift of a clock; a drift of 20 ppm gains 20 us per second | s, s/s |
| t_f, t_e | beginning and end of a fault `clock` with step s_f and drift rho_f | s |

    ahead(t) = theta + rho t + sum over faults that have begun: s_f (while t < t_e) + rho_f (min(t, t_e) - t_f)

A clock shows t + ahead(t), but never less than 0. When a fault ends, its step is undone and its drift stops; what the
drift has added stays. The numbers are whole nanoseconds, so every process computes the same.

Clocks change what agents and modems take for the time. They never change simulated time: a tick stays a tick, and a log
has the true time.

The world and netem read the clocks, and no agent does. So a live fault of a clock reaches an external agent, too. An
agent that read its clock itself would need the timeline of faults in its slice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

CLOCK = "clock"  # the kind of a fault


@dataclass(frozen=True, slots=True)
class VehicleClock:
    """How the clock of a vehicle is set at the start of a run."""

    offset_ns: int = 0  # theta, by which it is ahead at the start
    drift: float = 0.0  # rho, s/s


class ClockChange(Protocol):
    """A fault of the network or of the world; of kind `clock` its values are step [s] and drift [s/s]."""

    @property
    def kind(self) -> Any: ...
    @property
    def begin(self) -> int: ...
    @property
    def end(self) -> int | None: ...
    @property
    def vehicles(self) -> tuple[int, ...]: ...
    @property
    def values(self) -> tuple[float, ...]: ...


class Clocks:
    """The clocks of a fleet. Those that nobody sets are right."""

    def __init__(self, own: Mapping[int, VehicleClock], faults: Iterable[ClockChange], tick_ns: int) -> None:
        """Take the clocks.

        Args:
            own: the clocks that are set, by vehicle.
            faults: all faults of the run; those of kind `clock` count.
            tick_ns: length of a tick [ns].
        """
        self._own = own
        self._faults = [fault for fault in faults if fault.kind == CLOCK]
        self._tick_ns = tick_ns

    @classmethod
    def that_differ(cls, own: Mapping[int, VehicleClock], faults: Iterable[ClockChange], tick_ns: int) -> Clocks | None:
        """Make the clocks if they are needed.

        Args:
            own: as for the class.
            faults: likewise.
            tick_ns: length of a tick [ns].

        Returns:
            The clocks; None if no clock is set and no fault changes one. Callers can then ignore clocks.
        """
        clocks = cls(own, faults, tick_ns)
        return clocks if own or clocks._faults else None

    def ahead_ns(self, i: int, tick: int) -> int:
        """Compare a clock with simulated time.

        Args:
            i: number of the vehicle.
            tick: of simulated time.

        Returns:
            By how much the vehicle's clock is ahead [ns].
        """
        clock = self._own.get(i, _RIGHT)
        ahead = clock.offset_ns + round(clock.drift * (tick * self._tick_ns))
        for fault in self._concerning(i, tick):
            step_s, drift = fault.values
            lasts = fault.end is None or tick < fault.end
            until = tick if lasts or fault.end is None else fault.end
            ahead += round(drift * ((until - fault.begin) * self._tick_ns)) + (round(step_s * 1e9) if lasts else 0)
        return ahead

    def reading_ns(self, i: int, tick: int) -> int:
        """Read a clock.

        Args:
            i: number of the vehicle.
            tick: of simulated time.

        Returns:
            The time that the vehicle's clock shows [ns], at least 0.
        """
        return max(0, tick * self._tick_ns + self.ahead_ns(i, tick))

    def reading_ticks(self, i: int, tick: int) -> int:
        """Read a clock as `reading_ns` does, in whole ticks."""
        return self.reading_ns(i, tick) // self._tick_ns

    def drift(self, i: int, tick: int) -> float:
        """Say how fast a clock gains.

        Args:
            i: number of the vehicle.
            tick: of simulated time.

        Returns:
            The drift of the vehicle's clock [s/s], with that of its faults.
        """
        drifts = [f.values[1] for f in self._concerning(i, tick) if f.end is None or tick < f.end]
        return self._own.get(i, _RIGHT).drift + sum(drifts)

    def _concerning(self, i: int, tick: int) -> list[ClockChange]:
        return [f for f in self._faults if f.begin <= tick and (not f.vehicles or i in f.vehicles)]


_RIGHT = VehicleClock()
