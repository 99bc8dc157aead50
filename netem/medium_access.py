"""Medium access: computes the tick when a modem may start to send.

`aloha` and `csma` draw a back-off. With `tdma` the vehicles have slots in the order of their numbers. A vehicle starts
when its own clock reaches its next slot. The start is rounded up to a whole tick of simulated time, so it is at most
one tick late. It is fixed at the round tick, from the offset and the drift of the clock at that tick. A later step of
the clock does not move it.
"""

from __future__ import annotations

from netem.config import NetemConfig
from netem.draws import uniform
from netem.modem import AcousticConfig
from netem.station import Station
from netem.vehicle_clock import Clocks

BACK_OFF = "back-off"  # purpose of draws
_LEAST_RATE = 0.1  # s/s: a clock that goes slower is taken to go so fast, or a slot might never come


class Access:
    """The medium access of all modems of a run."""

    def __init__(self, config: NetemConfig, acoustic: AcousticConfig) -> None:
        self._config = config
        self._acoustic = acoustic
        self._order = {i: k for k, i in enumerate(sorted(config.vehicles))}
        self._clocks: Clocks | None = None
        self._tick = 0

    def begin_round(self, tick: int, clocks: Clocks | None) -> None:
        """The round that begins at a tick; `clocks` None: all clocks are right."""
        self._tick, self._clocks = tick, clocks

    def next_start(self, station: Station, earliest: int) -> int:
        """The start tick of a modem that is ready to transmit from tick `earliest` on."""
        acoustic, src = self._acoustic, station.vehicle
        if acoustic.mac != "tdma":
            station.draws += 1
            drawn = uniform(self._config.seed, BACK_OFF, src, station.draws)
            return earliest + int(drawn * (acoustic.backoff_ticks + 1))
        slot, turn = acoustic.slot_ticks, len(self._order) * acoustic.slot_ticks
        first = self._order[src] * slot
        if self._clocks is None:
            return first + max(0, -(-(earliest - first) // turn)) * turn
        tick_ns = self._config.tick_ns
        shown = self._shown_ns(src, earliest)
        turns = max(0, -(-(shown - first * tick_ns) // (turn * tick_ns)))
        return self._reaches(src, (first + turns * turn) * tick_ns, earliest)

    def _shown_ns(self, src: int, tick: int) -> int:
        """The time that a vehicle's clock will show at a tick, from its offset and drift at the round tick; negative
        before 0.
        """
        assert self._clocks is not None
        since = (tick - self._tick) * self._config.tick_ns
        ahead, drift = self._clocks.ahead_ns(src, self._tick), self._clocks.drift(src, self._tick)
        return self._tick * self._config.tick_ns + ahead + round(max(_LEAST_RATE, 1.0 + drift) * since)

    def _reaches(self, src: int, slot_ns: int, earliest: int) -> int:
        """The first tick, not before `earliest`, when a vehicle's clock shows at least `slot_ns`."""
        low, high = earliest - 1, earliest
        while self._shown_ns(src, high) < slot_ns:
            low, high = high, high + 2 * (high - low)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self._shown_ns(src, middle) >= slot_ns else (middle, high)
        return high
