"""When an error counts as settled: one rule for the result table, the checks and the report on the paper.

An error settles at the first time after which it stays below its limit to the end. That time must be long enough before
the end. The reason is a periodic disturbance: an error that crosses its limit in every period is below it for a moment
before the end of any run. Without a least length, the answer would depend on the end of the run: BOC, disturbed, would
have settled to 5 cm at 57.05 s of 60 and at 119.88 s of 120, with peaks of 0.070 m in every period.

No such rule sees rarer bursts. A gain without a bound has one every half minute, so `fleet reproduce` runs two minutes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import tau

from world.config import Harmonic

PERIODS = 2.0  # periods of the slowest harmonic of the disturbance; one would do if nothing else were going on
SHARE = 0.1  # share of the time that is judged, whatever the disturbance is ...
MOST_S = 10.0  # ... but no more than this


def least_s(disturbance: Iterable[Harmonic], judged_s: float) -> float:
    """The least time [s] that an error must stay below its limit, so that it counts as settled, under a disturbance by
    these harmonics, and of `judged_s` [s] at all.
    """
    slowest = min((abs(h.omega) for h in disturbance if h.amplitude and h.omega), default=0.0)
    periodic = PERIODS * tau / slowest if slowest else 0.0
    return max(periodic, min(SHARE * judged_s, MOST_S))


def first_settled(values: Sequence[float], limit: float, begin: int, end: int) -> int:
    """The first place in `begin .. end` after which all values before `end` are below the limit; `end` if there is
    none.
    """
    place = end
    while place > begin and values[place - 1] < limit:  # what is no number is not below
        place -= 1
    return place


def settling_time(
    times: Sequence[float], values: Sequence[float], limit: float, disturbance: Iterable[Harmonic]
) -> float | None:
    """How long [s] after the first of the times a value settled below a limit; None if it did not, or too late."""
    first = first_settled(values, limit, 0, len(values))
    if first == len(values) or not is_long_enough(times, first, len(times), least_s(disturbance, times[-1] - times[0])):
        return None
    return float(times[first] - times[0])


def is_long_enough(times: Sequence[float], first: int, end: int, least: float) -> bool:
    """Whether it is at least `least` seconds from place `first` to the last before `end`."""
    return bool(times[end - 1] - times[first] >= least - 1e-9)  # times are sums of ticks
