"""By how much a check on a signal holds: the quantitative semantics of signal temporal logic, sample by sample.

| symbol | meaning | unit |
|---|---|---|
| rho(x) | how far a value is inside the condition: min(x - low, high - x); below 0 outside | of the signal |
| w | how long a stretch has to be, `for_at_least` | s |
| d | how soon something has to begin, `eventually_within` | s |

| asked | formula | margin, the least over vehicles and waits |
|---|---|---|
| always | G phi | min_t rho(t) |
| never | G not phi | min_t -rho(t) |
| never for w | G not G[0,w] phi | min_t max_[t,t+w] -rho |
| eventually within d for w | F[0,d] G[0,w] phi | max_{t <= d} min_[t,t+w] rho |

Source: G. E. Fainekos, G. J. Pappas, "Robustness of temporal logic specifications for continuous-time signals", 2009. A
condition that no value fulfils by more than 0 (equal, agreed, true) has no such distance. Where it is about a time, its
margin is one in time (A. Donze, O. Maler, "Robust satisfaction of temporal logic over real-valued signals", 2010): how
much longer it could have taken.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import inf

from fleet.checks.api import Margin
from fleet.scenario.sections.signal_checks import AskedOfSignal, SignalCondition

Unit = tuple[int, ...]  # the vehicle that a number belongs to, or those that make a spread or are true


def inside(condition: SignalCondition, value: float) -> float:
    """rho: how far a value is inside a condition, in the unit of the value."""
    return min(value - condition.low, condition.high - value)


def in_time(asked: AskedOfSignal) -> bool:
    """Whether the margin of a check is one in time."""
    condition = asked.condition
    timed = asked.within_ns is not None or asked.least_ns > 0
    return timed and (condition.over == "true" or condition.low == condition.high)


class AlwaysMargin:
    """The margin of a safety property."""

    def __init__(self, asked: AskedOfSignal, tick_ns: int, every: int) -> None:
        """Begin; `every`: ticks between two samples."""
        self._asked, self._tick_s, self._every = asked, tick_ns / 1e9, every
        self._width = -(-asked.least_ns // tick_ns)  # ticks of a stretch that breaks it
        self._since: dict[Unit, int] = {}  # where the samples begin that have no gap
        self._best: dict[Unit, deque[tuple[int, float]]] = {}  # samples that may be the best of a stretch, falling
        self._least: tuple[float, int] | None = None  # margin, tick

    def step(self, tick: int, numbers: Sequence[tuple[Unit, float | None]]) -> None:
        """Take the samples of a tick, by their vehicle or link; None: it has no sample."""
        asked = self._asked
        for key, value in numbers:
            if value is None:
                self._since.pop(key, None)
                self._best.pop(key, None)
                continue
            good = inside(asked.condition, value)
            good = -good if asked.negated else good
            if self._width:
                best = self._stretch(tick, key, good)
                if best is None:
                    continue
                good = best
            if self._least is None or good < self._least[0]:
                self._least = good, tick

    def _stretch(self, tick: int, key: Unit, good: float) -> float | None:
        """The best sample of the shortest stretch up to now that would break it; None: no stretch is long enough."""
        first = (tick - self._width) // self._every * self._every
        best = self._best.setdefault(key, deque())
        while best and best[-1][1] <= good:
            best.pop()
        best.append((tick, good))
        while best[0][0] < first:
            best.popleft()
        return best[0][1] if self._since.setdefault(key, tick) <= first else None

    def found(self, longest: float | None, at: int | None) -> Margin | None:
        """The margin so far.

        Args:
            longest: length of the longest stretch of bad samples [ticks].
            at: first tick of that stretch.
        """
        asked = self._asked
        if in_time(asked):
            took = (longest or 0) * self._tick_s
            return Margin(asked.least_ns / 1e9 - took, "s", None if at is None else at * self._tick_s)
        if self._least is None or abs(self._least[0]) == inf:
            return None
        return Margin(self._least[0], _unit(asked), self._least[1] * self._tick_s)


class EventuallyMargin:
    """The margin of a liveness property, as a distance."""

    def __init__(self, asked: AskedOfSignal, tick_ns: int) -> None:
        self._asked, self._tick_s = asked, tick_ns / 1e9
        assert asked.within_ns is not None
        self._within, self._width = asked.within_ns // tick_ns, -(-asked.least_ns // tick_ns)  # ticks
        self._begin: int | None = None
        self._worst: dict[Unit, deque[tuple[int, float]]] = {}  # samples that may be the worst of a stretch, rising
        self._since: dict[Unit, int] = {}
        self._best: dict[Unit, tuple[float, int]] = {}  # of each, in the wait that goes on
        self._least: tuple[float, int] | None = None

    def begin(self, tick: int) -> None:
        """A wait begins."""
        self._begin = tick
        self._worst, self._since, self._best = {}, {}, {}

    def end(self, *, counts: bool) -> None:
        """The wait ends; `counts`: it was judged."""
        self._least, self._begin = self._so_far(counts), None

    def step(self, tick: int, numbers: Sequence[tuple[Unit, float | None]]) -> None:
        """Take the samples of a tick, by their vehicle or link; None: it has no sample."""
        if self._begin is None:
            return
        for key, value in numbers:
            if value is None:
                self._worst.pop(key, None)
                self._since.pop(key, None)
                continue
            good = inside(self._asked.condition, value)
            worst = self._worst.setdefault(key, deque())
            while worst and worst[-1][1] >= good:
                worst.pop()
            worst.append((tick, good))
            while worst[0][0] < tick - self._width:
                worst.popleft()
            since = self._since.setdefault(key, tick)
            start = tick - self._width  # of the stretch that ends now
            if since <= start <= self._begin + self._within and abs(worst[0][1]) < inf:
                self._best[key] = max(self._best.get(key, (-inf, 0)), (worst[0][1], tick))

    def _so_far(self, counts: bool) -> tuple[float, int] | None:
        waits = [self._least] if self._least is not None else []
        if counts and self._begin is not None and self._best:
            waits.append(min(self._best.values()))
        return min(waits, default=None)

    def found(self, *, counts: bool) -> Margin | None:
        """The least margin of all waits with a verdict; `counts`: the wait that goes on has one, too."""
        least = self._so_far(counts)
        return None if least is None else Margin(least[0], _unit(self._asked), least[1] * self._tick_s)


def _unit(asked: AskedOfSignal) -> str:
    return "vehicles" if asked.condition.over == "true" else asked.unit
