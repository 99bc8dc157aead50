"""A check on a signal while it is judged: sample by sample, in memory that does not grow with the run.

Its margin says by how much the check holds. This is the robustness of signal temporal logic:

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

Source: G. E. Fainekos, G. J. Pappas, "Robustness of temporal logic specifications for continuous-time signals",
2009. A condition that no value fulfils by more than 0 (equal, agreed, true) has no such distance. Where it is about
a time, its margin is one in time (A. Donze, O. Maler, "Robust satisfaction of temporal logic over real-valued
signals", 2010): how much longer it could have taken.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from math import inf, isnan, nan

from fleet.checks.api import Failure, Margin
from fleet.checks.values import TickValues
from fleet.result.verdict import Moment, Verdict, who
from fleet.scenario.scenario import Scenario
from fleet.scenario.schema.checks import EVERY
from fleet.scenario.sections.signal_checks import AskedOfSignal, SignalCondition
from fleet.scenario.sections.signals import SignalPlace
from fleet.scenario.sections.timeline import Event

Unit = tuple[int, ...]  # the vehicle that a number belongs to, or the vehicles that make a spread
_FLEET: Unit = ()  # one number of all vehicles


class RunningSignalCheck:
    """A check on a signal, and what was found so far."""

    def __init__(
        self,
        name: str,
        asked: AskedOfSignal,
        scenario: Scenario,
        vehicles: Mapping[int, Mapping[str, SignalPlace]],
        begin: int,
    ) -> None:
        """Begin with the run; samples before tick `begin` do not count."""
        self.name, self.words, self.group = name, asked.words, asked.signal.group
        self.signals = (str(asked.signal),)
        self._asked, self._tick_ns, self._last = asked, scenario.tick_ns, scenario.ticks
        self._every = scenario.log_every[asked.signal.group]
        self._after = max(begin, -(-asked.after_ns // scenario.tick_ns))
        self._places = [
            (i, place.values) for i in asked.vehicles if (place := vehicles[i].get(asked.signal.name)) is not None
        ]
        # NaN is nothing to report. But a program of others that runs and has said nothing has failed, and not passed.
        self._must_speak = bool(scenario.nodes) and not asked.sometimes
        self._safety = _Safety(asked, scenario, self._every) if asked.within_ns is None else None
        self._liveness = None if self._safety else _Liveness(asked, scenario, self._after)

    def event(self, event: Event) -> None:
        if self._liveness is not None:
            self._liveness.event(event)

    def step(self, values: TickValues) -> Failure | None:
        """Take the samples of a tick; returns how the check fails if it fails at this tick, the first time."""
        tick = values.tick
        if tick < self._after or (tick % self._every and tick != self._last):
            return None
        signal, found = self._asked.signal, list[tuple[int, float | None]]()
        for i, place in self._places:
            some = values.values(i, signal.group)[place]
            value = signal.value(some) if some else None
            found.append((i, None if value is None or (isnan(value) and not self._must_speak) else value))
        numbers = found if self._asked.condition.over == "each" else None
        there = [(i, value) for i, value in found if value is not None]
        judge = self._safety or self._liveness
        assert judge is not None
        each = [((i,), value) for i, value in numbers] if numbers is not None else [_join_vehicles(self._asked, there)]
        units = judge.step(tick, each)
        if units is None:
            return None
        shown = dict(there)
        some_values = {f"uuv/{i}/{signal}": shown[i] for i in units if i in shown}
        return Failure(judge.failure, units, some_values)

    def verdict(self, moment: Moment | None, now: int, *, over: bool) -> Verdict:
        """The verdict so far, at tick `now`; `moment`, None: the check has not failed. `over`: the run has come to its
        end.
        """
        judge = self._safety or self._liveness
        assert judge is not None
        passed, found, value, limit, unit = judge.result(now, over=over)
        if self._asked.sometimes:
            words = judge.failure or found
            return Verdict(self.name, True, self.words, words, None, limit, unit, None, self.signals).of_sometimes(
                bool(judge.failure)
            )
        verdict = Verdict(
            self.name,
            bool(passed) and moment is None,
            self.words,
            found,
            value,
            limit,
            unit,
            moment,
            self.signals,
            judged=passed is not None or moment is not None,
        )
        margin = judge.margin()
        return verdict if margin is None else verdict.with_margin(margin.value, margin.unit, margin.at_s)


def _join_vehicles(asked: AskedOfSignal, there: Sequence[tuple[int, float]]) -> tuple[Unit, float | None]:
    """The number of the fleet, and the vehicles that make it."""
    if silent := tuple(i for i, value in there if isnan(value)):
        return silent, nan
    if asked.condition.over == "true":
        true = tuple(i for i, value in there if value)
        return true, float(len(true)) if there else None
    if len(there) < 2:
        return _FLEET, None
    low, high = min(there, key=lambda one: one[1]), max(there, key=lambda one: one[1])
    if low[1] == high[1]:  # the difference of equal infinities is no number
        return _FLEET, 0.0
    return tuple(sorted((low[0], high[0]))), high[1] - low[1]


_Found = tuple[bool | None, str, float | None, float | None, str]  # passed, found, value, limit, unit


class _Safety:
    """Something bad never happens, or never lasts so long."""

    def __init__(self, asked: AskedOfSignal, scenario: Scenario, every: int) -> None:
        self._asked, self._tick_ns, self._names = asked, scenario.tick_ns, scenario.names
        self._margin = AlwaysMargin(asked, scenario.tick_ns, every)
        self._since: dict[Unit, int] = {}  # where a stretch of bad samples began
        self._worst: tuple[float, float, Unit, int] | None = None  # how bad, value, whose, tick
        self._longest: tuple[int, Unit, int] | None = None  # ticks, whose, since
        self._first = -1  # tick at which it failed, and the longest stretch by then
        self._by_then: tuple[int, Unit, int] | None = None
        self._silent: list[Unit] = []  # whose silence made it fail
        self._spoke: dict[Unit, int] = {}  # the tick of the first number of each
        self.failure = ""

    def step(self, tick: int, numbers: Sequence[tuple[Unit, float | None]]) -> Unit | None:
        asked = self._asked
        condition, each, failed = asked.condition, asked.condition.over == "each", list[int]()
        silent: list[Unit] = []
        values: list[float] = []
        told = [(unit if each else _FLEET, None if value is None or isnan(value) else value) for unit, value in numbers]
        self._margin.step(tick, told)
        for unit, value in numbers:
            key = unit if each else _FLEET
            if value is None:
                self._since.pop(key, None)
                continue
            bad = inf if isnan(value) else self._badness(value)
            if not isnan(value):
                self._spoke.setdefault(key, tick)
            if self._worst is None or bad > self._worst[0]:
                self._worst = bad, value, unit, tick
            if not isnan(value) and condition.holds(value) != asked.negated:
                self._since.pop(key, None)
                continue
            since = self._since.setdefault(key, tick)
            if self._longest is None or tick - since > self._longest[0]:
                self._longest = tick - since, unit, since
            if (tick - since) * self._tick_ns >= asked.least_ns:
                failed += unit
                values.append(value)
                if isnan(value):
                    silent.append(key)
        if not values or self.failure:
            return None
        listed = ", ".join(self._show(value) for value in values[:8])
        more = f" and {len(failed) - 8} more" if len(failed) > 8 else ""
        lasting = f", for {self._s(self._longest[0])} s by then" if asked.least_ns > 1 and self._longest else ""
        self.failure = f"{listed}{who(failed[:8], self._names)}{more} at {self._s(tick)} s{lasting}"
        self._first, self._by_then, self._silent = tick, self._longest, silent
        return tuple(failed)

    def _then(self, *, over: bool) -> str:
        """When those had told a number whose silence made it fail; empty: nobody's did."""
        if not self._silent:
            return ""
        times = [self._spoke.get(key) for key in self._silent]
        late = [at for at in times if at is not None]
        if len(late) < len(times):
            return "none came" if over else ""
        return f"one came by {self._s(max(late))} s"

    def result(self, now: int, *, over: bool) -> _Found:
        asked, worst = self._asked, self._worst
        unit = "" if asked.unit == "1" else asked.unit
        limit = asked.condition.limit
        if asked.least_ns > 1:
            limit, unit = round(asked.least_ns / 1e9, 6), "s"  # without the 1 ns of "longer than"
        if worst is None:
            return None, "no sample" + ("" if over else " yet"), None, limit, unit
        if asked.least_ns > 1:
            value, words = 0.0, "at no time"
            if self._longest is not None:
                length, whose, since = self._longest
                value = length * self._tick_ns / 1e9
                words = f"for at most {value:g} s{who(whose, self._names)}, from {self._s(since)} s"
            if self.failure and self._longest == self._by_then:
                words = ""  # the failure says it already
        else:
            _, value, whose, tick = worst
            words = "" if tick == self._first else f"{self._side()} {self._show(value)}{who(whose, self._names)}"
            words += f" at {self._s(tick)} s" if words else ""
        return (
            not self.failure,
            "; ".join(filter(None, (self.failure, self._then(over=over), words))),
            value,
            limit,
            unit,
        )

    def margin(self) -> Margin | None:
        if self._worst is None:
            return None
        return self._margin.margin(*((None, None) if self._longest is None else (self._longest[0], self._longest[2])))

    def _badness(self, value: float) -> float:
        condition = self._asked.condition
        if condition.low == -inf:
            bad = value
        elif condition.high == inf:
            bad = -value
        else:
            bad = max(condition.low - value, value - condition.high)
        return -bad if self._asked.negated else bad

    def _side(self) -> str:
        condition = self._asked.condition
        if condition.low == -inf or condition.high == inf:
            return "at most" if (condition.low == -inf) != self._asked.negated else "at least"
        return "nearest to it" if self._asked.negated else "farthest off"

    def _show(self, value: float) -> str:
        over = self._asked.condition.over
        if isnan(value):
            return "no value yet"
        if over == "true":
            return f"{value:g} true"
        return f"{value:.4g}{'' if self._asked.unit == '1' else f' {self._asked.unit}'}{' apart' * (over == 'spread')}"

    def _s(self, ticks: int) -> str:
        return f"{ticks * self._tick_ns / 1e9:g}"


class _Liveness:
    """Something good happens at last: within a time after the start, or after the end of faults."""

    def __init__(self, asked: AskedOfSignal, scenario: Scenario, after: int) -> None:
        self._asked, self._tick_ns, self._last, self._after = asked, scenario.tick_ns, scenario.ticks, after
        self._names = scenario.names
        self._begin: int | None = after if asked.fault is None else None  # begin of the wait that goes on
        self._whose = ""  # fault
        self._since: dict[Unit, int] = {}  # where it began to hold
        self._done: set[Unit] = set()
        self._took: tuple[int, Unit, str] | None = None  # ticks, whose, after which fault: the slowest of this wait
        self._slowest: tuple[int, Unit, str] | None = None  # the slowest of all waits that were judged
        self._judged = self._dropped = 0  # waits
        self._late_ns = 0  # how much later than asked it was when a wait failed
        self._distance = EventuallyMargin(asked, scenario.tick_ns)
        if self._begin is not None:
            self._distance.begin(self._begin)
        self.failure = ""

    def event(self, event: Event) -> None:
        """A wait begins where a fault ends, and is given up where another begins: it had no fair chance."""
        asked = self._asked
        if asked.fault is None or not event.is_fault:
            return
        if event.action == "begins":
            self._distance.end(counts=self._begin is None)
            self._dropped += self._begin is not None
            self._begin = None
        elif asked.fault in (EVERY, event.fault) and self._after <= event.tick < self._last:
            self._distance.end(counts=self._begin is None)
            self._distance.begin(event.tick)
            self._dropped += self._begin is not None
            self._begin, self._whose = event.tick, event.fault
            self._since, self._done, self._took = {}, set(), None

    def step(self, tick: int, numbers: Sequence[tuple[Unit, float | None]]) -> Unit | None:
        begin, asked = self._begin, self._asked
        each, late, failed = asked.condition.over == "each", False, list[int]()
        told = [(unit if each else _FLEET, None if value is None or isnan(value) else value) for unit, value in numbers]
        self._distance.step(tick, told)
        if begin is None:
            return None
        assert asked.within_ns is not None
        for unit, value in numbers:
            key = unit if each else _FLEET
            if key in self._done:
                continue
            since = tick
            if value is not None and asked.condition.holds(value):
                since = self._since.setdefault(key, tick)
                if (since - begin) * self._tick_ns <= asked.within_ns:
                    if (tick - since) * self._tick_ns >= asked.least_ns:
                        self._done.add(key)
                        if self._took is None or since - begin > self._took[0]:
                            self._took = since - begin, unit, self._whose
                    continue
            else:
                self._since.pop(key, None)
            if (tick - begin) * self._tick_ns > asked.within_ns:
                failed += unit
                late = True
        if len(self._done) == (len(numbers) if each else 1):
            self._judged += 1
            if self._slowest is None or (self._took is not None and self._took[0] > self._slowest[0]):
                self._slowest = self._took
            self._begin = None
        if not late:
            return None
        self._begin = None
        self._late_ns = max(self._late_ns, (tick - begin) * self._tick_ns - asked.within_ns)
        if self.failure:
            return None
        more = f" and {len(failed) - 8} more" if len(failed) > 8 else ""
        those = f"{who(failed[:8], self._names)}{more}"
        self.failure = f"not within {asked.within_ns / 1e9:g} s after {self._since_when(begin)}{those}"
        return tuple(failed)

    def margin(self) -> Margin | None:
        asked = self._asked
        assert asked.within_ns is not None
        if not is_timed(asked):
            return self._distance.margin(counts=self._begin is None)
        if self.failure:
            return Margin(-self._late_ns / 1e9, "s", None)
        if self._slowest is None:
            return None
        return Margin((asked.within_ns - self._slowest[0] * self._tick_ns) / 1e9, "s", None)

    def _since_when(self, begin: int) -> str:
        at = f"{begin * self._tick_ns / 1e9:g} s"
        return f"the end of fault {self._whose} at {at}" if self._whose else at

    def result(self, now: int, *, over: bool) -> _Found:
        asked = self._asked
        assert asked.within_ns is not None
        limit = asked.within_ns / 1e9
        if self.failure:
            return False, self.failure, inf, limit, "s"
        waits = f"{self._dropped} waits were" if self._dropped > 1 else "a wait was"
        dropped = f"; {waits} cut short by another fault" if self._dropped else ""
        if self._begin is not None:
            waited = f"{(now - self._begin) * self._tick_ns / 1e9:g} s after {self._since_when(self._begin)}"
            words = f"the run ended {waited}, too soon to say" if over else "there is still time"
            return None, words + dropped, None, limit, "s"
        if self._slowest is None:
            words = "no fault has ended" if not over else "no fault ended while the run lasted"
            return None, (dropped[2:] or words), None, limit, "s"
        ticks, unit, fault = self._slowest
        took = ticks * self._tick_ns / 1e9
        each = f", the slowest of {self._judged}, after fault {fault}" if fault and self._judged > 1 else ""
        return True, f"after {took:g} s{who(unit, self._names)}{each}{dropped}", took, limit, "s"


def inside(condition: SignalCondition, value: float) -> float:
    """rho: how far a value is inside a condition, in the unit of the value."""
    return min(value - condition.low, condition.high - value)


def is_timed(asked: AskedOfSignal) -> bool:
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

    def margin(self, longest: float | None, at: int | None) -> Margin | None:
        """The margin so far, of the longest stretch of bad samples [ticks], which began at tick `at`."""
        asked = self._asked
        if is_timed(asked):
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
        self._best: dict[Unit, tuple[float, int]] = {}  # the best margin of each, in the wait that goes on
        self._least: tuple[float, int] | None = None

    def begin(self, tick: int) -> None:
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
            start = tick - self._width  # the stretch that ends now begins there
            if since <= start <= self._begin + self._within and abs(worst[0][1]) < inf:
                self._best[key] = max(self._best.get(key, (-inf, 0)), (worst[0][1], tick))

    def _so_far(self, counts: bool) -> tuple[float, int] | None:
        waits = [self._least] if self._least is not None else []
        if counts and self._begin is not None and self._best:
            waits.append(min(self._best.values()))
        return min(waits, default=None)

    def margin(self, *, counts: bool) -> Margin | None:
        """The least margin of all waits with a verdict; `counts`: the wait that goes on has one, too."""
        least = self._so_far(counts)
        return None if least is None else Margin(least[0], _unit(self._asked), least[1] * self._tick_s)


def _unit(asked: AskedOfSignal) -> str:
    return "vehicles" if asked.condition.over == "true" else asked.unit
